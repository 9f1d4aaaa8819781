/* A small CAN FMU for tests: sends a frame of counters each period; built by tests/network/can_nodes.py. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { RX_DATA = 1, TX_DATA = 2, RX_CLOCK = 3, TX_CLOCK = 4 };

typedef struct {
    int64_t now, next;
    uint8_t tx[2048], rx[2048];
    size_t tx_size, rx_size;
    bool tx_active, again, taken;
    uint8_t count, received, confirmed, lost, errors, refused;
} Node;

static void put(Node* n, const void* data, size_t size) {
    memcpy(n->tx + n->tx_size, data, size);
    n->tx_size += size;
}

static void put_number(Node* n, uint32_t value, int bytes) {
    for (int k = 0; k < bytes; k++, value >>= 8) {
        uint8_t byte = (uint8_t)value;
        put(n, &byte, 1);
    }
}

static void configure(Node* n) {
    put_number(n, 0x40, 4), put_number(n, 13, 4), put_number(n, 1, 1), put_number(n, BITRATE, 4);
    put_number(n, 0x40, 4), put_number(n, 10, 4), put_number(n, 4, 1), put_number(n, DISCARD ? 2 : 1, 1);
}

static void transmit(Node* n) {
    const uint8_t data[8] = {n->count++, n->received, n->confirmed, n->lost, n->errors, n->refused, 0, 0xA5};
#ifdef CAN_FD /* with bit rate switch, 12 bytes */
    put_number(n, 0x11, 4), put_number(n, 29, 4), put_number(n, IDENTIFIER, 4), put_number(n, 0x000100, 3);
    put_number(n, 12, 2), put(n, data, 8), put_number(n, 0, 4);
#else
    put_number(n, 0x10, 4), put_number(n, 24, 4), put_number(n, IDENTIFIER, 4), put_number(n, 0, 2);
    put_number(n, 8, 2), put(n, data, 8);
#endif
#ifdef BROKEN
    put_number(n, 0xDEAD, 4), put_number(n, 8, 4);
#endif
}

static void transmit_due(Node* n) {
    for (; n->next <= n->now; n->next += PERIOD_NS) transmit(n);
}

static void take(Node* n) {
    for (size_t at = 0; at + 8 <= n->rx_size;) {
        uint32_t code, length;
        memcpy(&code, n->rx + at, 4), memcpy(&length, n->rx + at + 4, 4);
        n->received += code == 0x10, n->confirmed += code == 0x20, n->refused += code == 0x01;
        n->errors += code == 0x31;
        if (code == 0x30) n->lost++, n->again = true;
        at += length;
    }
    n->rx_size = 0;
}

FMI3_Export const char* fmi3GetVersion(void) { return "3.0"; }

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Node* n = events ? calloc(1, sizeof(Node)) : NULL;
    if (n) n->next = OFFSET_NS, configure(n), n->tx_active = true;
    return n;
}

FMI3_Export void fmi3FreeInstance(fmi3Instance n) { free(n); }
FMI3_Export fmi3Status fmi3EnterInitializationMode(
    fmi3Instance n, fmi3Boolean a, fmi3Float64 b, fmi3Float64 c, fmi3Boolean d, fmi3Float64 e) {
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance n) { return fmi3OK; }
FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance n) { return fmi3OK; }
FMI3_Export fmi3Status fmi3EnterStepMode(fmi3Instance n) { return fmi3OK; }
FMI3_Export fmi3Status fmi3Terminate(fmi3Instance n) { return fmi3OK; }

FMI3_Export fmi3Status fmi3SetClock(
    fmi3Instance i, const fmi3ValueReference r[], size_t count, const fmi3Clock values[]) {
    Node* n = i;
    if (r[0] == TX_CLOCK) {
        if (n->again) n->again = false, transmit(n);
        transmit_due(n);
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetClock(
    fmi3Instance i, const fmi3ValueReference r[], size_t count, fmi3Clock values[]) {
    Node* n = i;
    values[0] = n->tx_active;
    n->tx_active = false; /* reading a clock clears it */
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetBinary(
    fmi3Instance i, const fmi3ValueReference r[], size_t count, const size_t sizes[],
    const fmi3Binary values[], size_t number) {
    Node* n = i;
    if (r[0] != RX_DATA || sizes[0] > sizeof n->rx) return fmi3Error;
    memcpy(n->rx, values[0], n->rx_size = sizes[0]);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetBinary(
    fmi3Instance i, const fmi3ValueReference r[], size_t count, size_t sizes[], fmi3Binary values[],
    size_t number) {
    Node* n = i;
    values[0] = n->tx, sizes[0] = n->tx_size, n->taken = true;
#ifdef LIE
    sizes[0] = LIE;
#endif
#ifdef NO_DATA
    values[0] = NULL;
#endif
    return r[0] == TX_DATA ? fmi3OK : fmi3Error;
}

FMI3_Export fmi3Status fmi3UpdateDiscreteStates(
    fmi3Instance i, fmi3Boolean* more, fmi3Boolean* end, fmi3Boolean* nominals, fmi3Boolean* values,
    fmi3Boolean* defined, fmi3Float64* next) {
    Node* n = i;
    *more = *end = *nominals = *values = *defined = false;
    if (n->taken) n->tx_size = 0, n->taken = false;
    take(n);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetIntervalDecimal(
    fmi3Instance i, const fmi3ValueReference r[], size_t count, fmi3Float64 intervals[],
    fmi3IntervalQualifier qualifiers[]) {
    Node* n = i;
#ifdef SILENT_UNTIL_NS
    qualifiers[0] = fmi3IntervalNotYetKnown;
    if (n->now < SILENT_UNTIL_NS) return fmi3OK;
#endif
    intervals[0] = n->again || n->tx_size ? 0.0 : 1e-9 * (double)(n->next - n->now);
#ifdef STUCK
    intervals[0] = STUCK;
#endif
    qualifiers[0] = fmi3IntervalChanged;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3DoStep(
    fmi3Instance i, fmi3Float64 at, fmi3Float64 step, fmi3Boolean no_set, fmi3Boolean* event,
    fmi3Boolean* end, fmi3Boolean* early, fmi3Float64* last) {
    Node* n = i;
    n->now = llround(1e9 * (at + step));
    *end = *early = *event = false, *last = at + step;
#ifdef EARLY_S
    *early = true, *last = EARLY_S;
#endif
#ifdef SILENT_UNTIL_NS
    if (at < 1e-9 * SILENT_UNTIL_NS && n->now > SILENT_UNTIL_NS) {
        n->now = SILENT_UNTIL_NS, *early = *event = true, *last = 1e-9 * SILENT_UNTIL_NS;
    }
#endif
#ifndef COUNTDOWN
    if (n->again) n->again = false, transmit(n);
    transmit_due(n);
    *event = n->tx_active = n->tx_size > 0;
#endif
    return fmi3OK;
}
