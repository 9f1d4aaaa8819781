/* A small CAN FMU for tests: sends a frame of counters each period; built by tests/network/can_nodes.py. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    int64_t now, next;
    uint8_t tx[2048], rx[2048];
    size_t tx_size, rx_size;
    bool tx_active, again, taken;
    uint8_t count, received, confirmed, lost, errors, refused;
} Node;

#include "can_node.h"

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

static void tick(Node* n) {
    if (n->again) n->again = false, transmit(n);
    transmit_due(n);
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
}

static void begin(Node* n) { n->next = OFFSET_NS, configure(n), n->tx_active = true; }

FMI3_Export Status fmi3GetClock(fmi3Instance i, Refs r, size_t count, fmi3Clock values[]) {
    Node* n = i;
    values[0] = n->tx_active;
    n->tx_active = false; /* reading a clock clears it */
    return fmi3OK;
}

static bool wait(const Node* n, double* seconds) {
#ifdef SILENT_UNTIL_NS
    if (n->now < SILENT_UNTIL_NS) return false;
#endif
    *seconds = n->again || n->tx_size ? 0.0 : 1e-9 * (double)(n->next - n->now);
#ifdef STUCK
    *seconds = STUCK;
#endif
    return true;
}

static void stepped(Node* n, double from, double* reached, bool* event, bool* early) {
#ifdef EARLY_S
    *early = true, *reached = EARLY_S;
#endif
#ifdef SILENT_UNTIL_NS
    if (from < 1e-9 * SILENT_UNTIL_NS && n->now > SILENT_UNTIL_NS) {
        n->now = SILENT_UNTIL_NS, *early = *event = true, *reached = 1e-9 * SILENT_UNTIL_NS;
    }
#endif
#ifndef COUNTDOWN
    tick(n);
    *event = n->tx_active = n->tx_size > 0;
#endif
}
