/* The plant: parameters, state, fixed-step integration, outputs. Both FMI faces stand on this.
 *
 * A Plant is plain data: copying it copies the state.
 */
#ifndef STEWART_PLANT_H
#define STEWART_PLANT_H

#include <stddef.h>

#include "contact.h"
#include "mechanics.h"
#include "model.h"

#define REASON_SIZE 256

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED, BROKEN } Mode;

typedef struct {
    double v[N_VALUES]; /* every variable of the model description, see model.h */
    Motion x;
    double applied[LEGS]; /* N, behind the force lag */
    long long steps;      /* internal steps since the start */
    double start_time;
    Mode mode;
    int fresh; /* outputs: 0 stale, 1 kinematic ones valid, 2 all valid */
    /* Derived from the parameters when initialisation begins. */
    Body body;
    Stops stops;
    double friction[LEGS];
    double decay, decay_half; /* of the force lag over one and one half internal step */
} Plant;

/* All functions that can refuse return 0, or -1 with the reason written to why[REASON_SIZE]. */

void plant_reset(Plant *plant);

/* Take over parameters and the initial state. */
int plant_initialise(Plant *plant, char *why);

/* One value into the variable at `offset`: checked for mode, finiteness and range before it is stored. */
int plant_check(const Plant *plant, int offset, double value, char *why);
void plant_store(Plant *plant, int offset, double value);

/* Bring the output at `offset` up to date. */
int plant_refresh(Plant *plant, int offset, char *why);

/* From `time` by `dt` seconds with the inputs held. A refused step leaves the plant as it was. */
int plant_step(Plant *plant, double time, double dt, char *why);

#endif
