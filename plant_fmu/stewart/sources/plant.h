/* The plant: parameters, state, equations of motion, fixed-step integration, outputs. Both FMI interfaces use it.
 *
 * Notation: x_base = p + R x_platform; twist = [v of the platform origin; omega], base frame;
 * leg i runs from base joint a_i to platform joint B_i = p + R b_i, l its length, s its direction, tau > 0 extends.
 */
#ifndef STEWART_PLANT_H
#define STEWART_PLANT_H

#include <stddef.h>

#include "model.h"
#ifdef LS_BUS
#include "drives.h"
#endif

#define LEGS 6
#define REASON_SIZE 256
/* PLACE: index of a variable's first element among all values. VALUE: value of a plant at an index. */
#define PLACE(name) ((int)(offsetof(Values, name) / sizeof(double)))
#define VALUE(plant, place) (((double *)&(plant)->v)[place])

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED, BROKEN } Mode;

/* Pose as position and unit quaternion (scalar first), and twist. */
typedef struct {
    double p[3], q[4], twist[6];
} Motion;

/* Plain data: copying it copies the state. */
typedef struct Plant {
    Values v; /* every variable of the model description, see model.h */
    Motion x;
    double applied[LEGS]; /* N, after the force lag */
    long long steps;      /* internal steps since the start */
    double start_time;
    Mode mode;
    int fresh; /* outputs: 0 stale, 1 kinematic ones valid, 2 all valid */
    /* Computed from the parameters at initialisation. */
    double hinge[LEGS][3];    /* unit vectors: base-side hinge of each universal joint */
    double decay, decay_half; /* of the force lag over one and one half internal step */
#ifdef LS_BUS
    Drives drives;
#endif
} Plant;

/* The equations of motion at one state: M dtwist = rhs + J tau, and ddl = J^T dtwist + bias.
 * Arrays by component, then leg: a loop over the legs has six independent chains, which the processor overlaps. */
typedef struct {
    /* from geometry: arm = R b, velocity u of the platform joint, and the direction s in J */
    double arm[3][LEGS], u[3][LEGS], l[LEGS], dl[LEGS];
    double J[6][LEGS]; /* column i: [s, arm x s] */
    /* from leg_forces: w x (w x arm), leg force and ddl without dtwist, qt, qa - qt; the rest of J */
    double ds[3][LEGS], cc[3][LEGS], f[6][LEGS], bias[LEGS], qt[LEGS], q[LEGS];
    /* from leg_products: qt arm, qt (arm^2 1 - arm arm^T), (qa - qt) J; the moment in f */
    double h[3][LEGS], turning[3][3][LEGS], qJ[6][LEGS];
    double rhs[6];
    double L[6][6], d[6]; /* M = L diag(1/d) L^T, L unit lower triangular */
} Equations;

/* All functions that can fail return 0, or -1 with the reason in why[REASON_SIZE]. */

void plant_reset(Plant *plant);

/* Apply parameters and the initial state. */
int plant_initialise(Plant *plant, char *why);

/* Check if the variable at `place` can have this value: mode, finiteness and range. */
int plant_check(const Plant *plant, int place, double value, char *why);

/* Update the output at `place`. */
int plant_refresh(Plant *plant, int place, char *why);

/* Integrate from `time` for `dt` seconds with constant inputs. A failed step does not change the plant. */
int plant_step(Plant *plant, double time, double dt, char *why);

/* mechanics.c: mathematics only. No FMI, no allocation, no library beyond sqrt. */
void rotation_of(const double q[4], double R[9]);
void quaternion_of(const double R[9], double q[4]);

/* Fill only lengths and rates of `e`. */
void leg_kinematics(const Plant *plant, const Motion *x, Equations *e);

/* Fill `e`. Returns 0, or -1 if the mass matrix is not positive definite or a leg has no length. */
int equations_of_motion(const Plant *plant, const Motion *x, Equations *e);

/* y = M^-1 y. */
void solve_mass(const Equations *e, double y[6]);

/* Kinetic energy, and potential energy with its zero level through the origin of the base frame. */
void energies(Plant *plant);

/* contact.c: leg forces of brakes, dry friction and end stops, constant over one step of h seconds. Writes them to
 * tau[] and adds their effect to dtwist[], the acceleration without them. */
void contact_forces(const Values *v, const Equations *e, double h, double tau[LEGS], double dtwist[6]);

#endif
