/* Forces that are laws of inequality: brakes, dry friction, end stops. */
#ifndef STEWART_CONTACT_H
#define STEWART_CONTACT_H

#include "mechanics.h"

typedef struct {
    double length_min[LEGS], length_max[LEGS];
    double stop_stiffness, stop_damping;
} Stops;

/* Leg forces, constant over one step of h seconds, from brakes, friction and stops.
 *
 * friction[i] >= 0 is the largest force of brake and dry friction together; free[] is dtwist without these forces.
 * The forces solve, for the leg rates dl + h (J dtwist + bias) at the end of the step,
 *   stick     rate = 0          while |force| < friction,
 *   slip      force = -friction sign(rate) otherwise,
 *   stops     force = -k (overrun at the end of the step) - d rate, never pulling.
 * All coupled through J M^-1 J^T, so that the step is stable for any stiffness.
 * Adds them to tau[] and their effect to dtwist[]. Returns the number of laws that were active.
 */
int contact_forces(const Stops *stops, const Equations *e, const double friction[LEGS], const double free[6], double h,
                   double tau[LEGS], double dtwist[6]);

#endif
