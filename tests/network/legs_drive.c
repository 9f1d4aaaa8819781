/* Drives of protocol `legs`, layout fd, as a CAN FMU for tests. Written by hand from drivers/legs/legs.dbc.
 *
 * DRIVES: 6, or 1 with parameter `leg`. ANSWER_NS: time from SYNC to the feedback. Built by can_nodes.py.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { LENGTH = 10, RATE, FORCE, BRAKE, LEG = 20, CRASH };
enum { BOOT, OFF, READY, RUN, FAULT };
enum { MODE_OFF, MODE_READY, MODE_RUN, MODE_RESET };
enum { ESTOP_ID = 1, SYNC_ID = 128, COMMAND_ID = 272, FEEDBACK_ID = 641, CONFIG_ID = 1537, STATUS_ID = 1793 };
#define NEVER INT64_MAX
#define RATED_N 30000.0
#define RESOLUTION_M 1e-6
#define HEARTBEAT_NS 100000000
#define OPENS_NS 50000000
#define CLOSES_NS 30000000

typedef struct {
    uint8_t state, fault, counter, setup[11];
    bool configured, counted, shut, report;
    int64_t watchdog, deadline, moves, beat;
    double command, kept, length, rate, force;
} Drive;

typedef struct {
    int64_t now, answer, crash;
    int leg, cycle;
    double lengths[DRIVES], rates[DRIVES];
    Drive drives[DRIVES];
    uint8_t tx[8192], rx[8192];
    size_t tx_size, rx_size;
    bool taken;
} Node;

#include "can_node.h"

static unsigned crc(unsigned id, const uint8_t* data, int size, int bits) {
    const unsigned top = 1u << (bits - 1), mask = 2 * top - 1, polynomial = bits == 8 ? 0x1D : 0x5935;
    unsigned r = mask;
    for (int k = -2; k < size; k++) {
        r ^= (k == -2 ? id & 0xFF : k == -1 ? id >> 8 : data[k]) << (bits - 8);
        for (int bit = 0; bit < 8; bit++) r = (r & top ? r << 1 ^ polynomial : r << 1) & mask;
    }
    return bits == 8 ? r ^ 0xFF : r;
}

static void number(uint8_t* at, int64_t value, int bytes) {
    for (int k = 0; k < bytes; k++) at[k] = (uint8_t)(value >> 8 * k);
}

static void transmit(Node* n, unsigned id, const uint8_t* data, int size, bool fd) {
    uint8_t head[17] = {0};
    int at = fd ? 17 : 16;
    number(head, fd ? 0x11 : 0x10, 4), number(head + 4, at + size, 4), number(head + 8, id, 4);
    if (fd) head[13] = 1; /* bit rate switch */
    number(head + at - 2, size, 2);
    put(n, head, (size_t)at), put(n, data, (size_t)size);
}

static int leg_of(const Node* n, int k) { return DRIVES == 1 ? n->leg : k; }

static int64_t scaled(double value, double step, int64_t most) {
    double steps = rint(value / step);
    return steps > most ? most : steps < -most - 1 ? -most - 1 : (int64_t)steps;
}

static void feedback(Node* n, int k) {
    const Drive* d = &n->drives[k];
    unsigned id = FEEDBACK_ID + (unsigned)leg_of(n, k);
    uint8_t data[12];
    number(data, scaled(d->length, 1e-7, INT32_MAX), 4);
    number(data + 4, scaled(d->rate, 1e-7, INT32_MAX), 4);
    number(data + 8, scaled(100 * d->force / RATED_N, 0.00625, INT16_MAX), 2);
    data[10] = (uint8_t)(d->state << 4 | (n->cycle & 0xF));
    data[11] = (uint8_t)crc(id, data, 11, 8);
    transmit(n, id, data, 12, true);
}

static void status(Node* n, int k) {
    const Drive* d = &n->drives[k];
    unsigned id = STATUS_ID + (unsigned)leg_of(n, k);
    uint8_t data[5] = {d->state, d->fault};
    number(data + 2, d->configured ? crc(CONFIG_ID + (unsigned)leg_of(n, k), d->setup, 11, 16) : 0, 2);
    data[4] = (uint8_t)crc(id, data, 4, 8);
    transmit(n, id, data, 5, false);
}

static void enter(Drive* d, uint8_t state, uint8_t fault) {
    d->state = state, d->fault = fault, d->report = true;
    if (state != READY && state != RUN) d->command = 0.0, d->deadline = NEVER;
}

static void obey(Node* n, Drive* d, int mode, double force) {
    if (d->counted && d->counter == n->cycle) return; /* a repetition has no effect */
    d->counted = true, d->counter = (uint8_t)n->cycle;
    if (!d->configured) return;
    bool on = d->state == READY || d->state == RUN;
    if (mode == MODE_OFF && on) enter(d, OFF, 0);
    if (mode == MODE_READY && (d->state == OFF || d->state == RUN)) enter(d, READY, 0);
    if (mode == MODE_RUN && d->state == READY) enter(d, RUN, 0);
    if (mode == MODE_RESET && (on || d->state == FAULT)) enter(d, OFF, 0);
    if (d->state == READY || d->state == RUN) d->command = force, d->deadline = n->now + d->watchdog;
}

static void configure(Node* n, Drive* d, int leg, const uint8_t* data) {
    if (d->state == READY || d->state == RUN || data[5] != leg + 1 || data[6] != VERSION) return;
    uint32_t us;
    memcpy(&us, data, 4), memcpy(d->setup, data, 7), number(d->setup + 7, (int64_t)(RATED_N * 1000), 4);
    d->watchdog = 1000 * (int64_t)us, d->configured = d->report = true;
    if (d->state == BOOT) enter(d, OFF, 0);
}

static void hear(Node* n, unsigned id, const uint8_t* data, int size) {
    if (id == SYNC_ID && size == 2 && data[1] == crc(id, data, 1, 8) && data[0] != n->cycle) {
        n->cycle = data[0], n->answer = n->now + ANSWER_NS;
        for (int k = 0; k < DRIVES; k++) {
            Drive* d = &n->drives[k];
            d->length = rint(n->lengths[k] / RESOLUTION_M) * RESOLUTION_M, d->rate = n->rates[k];
        }
    }
    for (int k = 0; k < DRIVES; k++) {
        Drive* d = &n->drives[k];
        int leg = leg_of(n, k);
        if (id == ESTOP_ID && d->fault != 2) enter(d, FAULT, 2);
        if (id == CONFIG_ID + (unsigned)leg && size == 8 && data[7] == crc(id, data, 7, 8))
            configure(n, d, leg, data);
        if (id == COMMAND_ID && size == 32 && (unsigned)(data[26] | data[27] << 8) == crc(id, data, 26, 16)) {
            int32_t mN;
            memcpy(&mN, data + 4 * leg, 4);
            if (data[24] == n->cycle) obey(n, d, data[25], mN * 0.001);
        }
    }
}

static void brake(Node* n, Drive* d) {
    bool opens = d->state == RUN;
    if (d->shut == !opens) d->moves = NEVER;
    else if (d->moves == NEVER) d->moves = n->now + (opens ? OPENS_NS : CLOSES_NS);
    if (d->moves <= n->now) d->shut = !opens, d->moves = NEVER;
    double f = !opens && d->state != READY && !d->shut ? d->kept : d->command;
    d->force = d->kept = f > RATED_N ? RATED_N : f < -RATED_N ? -RATED_N : f;
}

/* What is due now: watchdogs, brakes, then frames. */
static void live(Node* n, bool sends) {
    if (n->crash && n->now >= n->crash) *(volatile int*)0 = 0;
    for (int k = 0; k < DRIVES; k++) {
        Drive* d = &n->drives[k];
        if (d->deadline < n->now) enter(d, FAULT, 1);
        brake(n, d);
        if (sends && (d->report || d->beat <= n->now)) {
            status(n, k);
            d->report = false;
            while (d->beat <= n->now) d->beat += HEARTBEAT_NS;
        }
    }
    if (!sends || n->answer > n->now) return;
    for (int k = 0; k < DRIVES; k++) feedback(n, k);
    n->answer = NEVER;
}

static bool wait(const Node* n, double* seconds) {
    int64_t at = n->answer;
    for (int k = 0; k < DRIVES; k++) {
        const Drive* d = &n->drives[k];
        int64_t late = d->deadline == NEVER ? NEVER : d->deadline + 1;
        at = d->report ? n->now : at < d->moves ? at : d->moves;
        at = at < late ? at : late;
        at = at < d->beat ? at : d->beat;
        if (d->report) break;
    }
    *seconds = n->tx_size || at <= n->now ? 0.0 : 1e-9 * (double)(at - n->now);
    return true;
}

static void take(Node* n) {
    for (size_t at = 0; at + 8 <= n->rx_size;) {
        const uint8_t* o = n->rx + at;
        uint32_t code, length, id;
        memcpy(&code, o, 4), memcpy(&length, o + 4, 4), memcpy(&id, o + 8, 4);
        int head = code == 0x11 ? 17 : 16;
        if ((code == 0x10 || code == 0x11) && !o[12]) hear(n, id, o + head, (int)length - head);
        at += length;
    }
    live(n, false);
}

static void begin(Node* n) {
    uint8_t rates[26] = {0};
    number(rates, 0x40, 4), number(rates + 4, 13, 4), rates[8] = 1, number(rates + 9, 1000000, 4);
    number(rates + 13, 0x40, 4), number(rates + 17, 13, 4), rates[21] = 2, number(rates + 22, FD_RATE, 4);
    n->cycle = -1, n->answer = NEVER;
    put(n, rates, sizeof rates);
    for (int k = 0; k < DRIVES; k++) {
        Drive* d = &n->drives[k];
        d->shut = true, d->deadline = d->moves = NEVER, d->beat = llround(k * (HEARTBEAT_NS / 6.0));
    }
}

static void tick(Node* n) { live(n, true); }
static void stepped(Node* n, double from, double* reached, bool* event, bool* early) {}

FMI3_Export Status fmi3SetInt32(
    fmi3Instance i, Refs r, size_t count, const fmi3Int32 values[], size_t number) {
    Node* n = i;
    if (r[0] == LEG) n->leg = values[0];
    if (r[0] == CRASH) n->crash = 1000000LL * values[0];
    return r[0] == LEG || r[0] == CRASH ? fmi3OK : fmi3Error;
}

FMI3_Export Status fmi3SetFloat64(
    fmi3Instance i, Refs r, size_t count, const fmi3Float64 values[], size_t number) {
    Node* n = i;
    if (count != 1 || number != DRIVES || (r[0] != LENGTH && r[0] != RATE)) return fmi3Error;
    memcpy(r[0] == LENGTH ? n->lengths : n->rates, values, sizeof n->rates);
    return fmi3OK;
}

FMI3_Export Status fmi3GetFloat64(
    fmi3Instance i, Refs r, size_t count, fmi3Float64 values[], size_t number) {
    Node* n = i;
    if (count != 1 || number != DRIVES || r[0] != FORCE) return fmi3Error;
    for (int k = 0; k < DRIVES; k++) values[k] = n->drives[k].force;
    return fmi3OK;
}

FMI3_Export Status fmi3GetBoolean(
    fmi3Instance i, Refs r, size_t count, fmi3Boolean values[], size_t number) {
    Node* n = i;
    if (count != 1 || number != DRIVES || r[0] != BRAKE) return fmi3Error;
    for (int k = 0; k < DRIVES; k++) values[k] = n->drives[k].shut;
    return fmi3OK;
}
