/* Six drives of the protocol `legs` on one CAN bus, in front of the plant. Times are whole ns since the start.
 * They behave as the emulated drives in plant_fmu/drives, to the bit: same order of operations, no contraction. */
#ifndef STEWART_DRIVES_H
#define STEWART_DRIVES_H

#include <stddef.h>
#include <stdint.h>

struct Plant;

typedef struct {
    int state, fault, reaction, acting; /* acting: reaction to the latched fault */
    int configured, counter;            /* counter: of the last command; -1: none */
    int64_t watchdog_ns, deadline_ns;   /* deadline: end of the watchdog time, or of damping and holding */
    int64_t moved_ns;                   /* when the moving brake has moved */
    double command, kept, force;        /* N: of the last command; last one of the drive; on the plant */
    double held, shut;                  /* m, length held by HOLD; 1: brake closed */
} Drive;

/* Plain data: copying it copies the state. */
typedef struct {
    Drive drive[6];
    int64_t now_ns, beats;               /* present time; number of heartbeats so far */
    int present, controls;               /* Cycle of the present SYNC, -1: none; a drive damps or holds */
    int event_mode, rx_clock, tx_clock;  /* true in event mode; clocks that tick at this instant */
    size_t size, taken;                  /* bytes of bus operations to send; of those, bytes that the importer read */
    unsigned char operations[BUS_BYTES]; /* if they are too many, the later ones are lost, as in a full mailbox */
} Drives;

/* Power up. Returns -1 with the reason if the plant refuses. */
int drives_start(struct Plant *plant, char *why);

/* Advance drives and plant to `time` + `dt`. Returns -1 with the reason if the plant refuses. */
int drives_step(struct Plant *plant, double time, double dt, char *why);

/* Process bus operations that arrive now. */
void drives_receive(struct Plant *plant, const unsigned char *bytes, size_t size);

/* Time from now to the next operation to send, ns; -1: none is known. */
int64_t drives_wait(const struct Plant *plant);

#endif
