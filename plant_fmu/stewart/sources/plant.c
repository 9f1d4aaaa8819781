/* Integration and outputs. */
#include "plant.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define STATES ((int)(sizeof(Motion) / sizeof(double)))

static int refuse(char *why, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why, REASON_SIZE, format, arguments);
    va_end(arguments);
    return -1;
}

/* exp(-x), x >= 0, by halving and squaring: the same bits on every C library. */
static double decay_of(double x)
{
    int halvings = 0;
    while (x > 0.0625) {
        x *= 0.5;
        halvings++;
        if (halvings > 60) return 0.0;
    }
    double term = 1.0, sum = 1.0;
    for (int k = 1; k < 14; k++) {
        term *= -x / k;
        sum += term;
    }
    while (halvings-- > 0) sum *= sum;
    return sum;
}

void plant_reset(Plant *plant)
{
    memset(plant, 0, sizeof *plant);
    memcpy(&plant->v, START, sizeof plant->v);
}

int plant_check(const Plant *plant, int place, double value, char *why)
{
    const Variable *of = &VARIABLES[OWNER[place]];
    const char *name = NAMES[place];
    if (of->causality != INPUT && of->causality != PARAMETER)
        return refuse(why, "%s is neither an input nor a parameter: it cannot be set", name);
    if (plant->mode >= TERMINATED)
        return refuse(why, "%s cannot be set after termination: reset the instance first", name);
    if (plant->mode == STEPPING && of->causality == PARAMETER)
        return refuse(why, "parameter %s is fixed: set it before initialisation ends", name);
    if (!isfinite(value)) return refuse(why, "%s was given a value that is not finite", name);
    if (value >= of->min && value <= of->max) return 0;
    return refuse(why, "%s = %g lies outside %g to %g", name, value, of->min, of->max);
}

/* Symmetric, and a mass distribution that can exist: trace/2 - I positive semidefinite (triangle inequality). */
static int physical(const double I[9])
{
    const double trace = I[0] + I[4] + I[8], tolerance = 1e-9 * trace;
    if (!(trace > 0.0)) return 0;
    if (fabs(I[1] - I[3]) > tolerance || fabs(I[2] - I[6]) > tolerance || fabs(I[5] - I[7]) > tolerance) return 0;
    const double a = 0.5 * trace - I[0] + tolerance, b = 0.5 * trace - I[4] + tolerance;
    const double c = 0.5 * trace - I[8] + tolerance;
    if (a < 0.0 || b < 0.0 || c < 0.0) return 0;
    const double ab = a * b - I[1] * I[1], ac = a * c - I[2] * I[2], bc = b * c - I[5] * I[5];
    const double det = a * bc + I[1] * (-I[1] * c + I[5] * I[2]) - I[2] * (I[1] * I[5] + b * I[2]);
    const double small = tolerance * trace;
    return ab > -small && ac > -small && bc > -small && det > -small * trace;
}

static int take_parameters(Plant *plant, char *why)
{
    const Values *v = &plant->v;
    if (!(v->mass > 0.0)) return refuse(why, "mass = %g kg: it must be positive", v->mass);
    if (!physical(v->inertia))
        return refuse(why, "inertia is not that of a body: it must be symmetric, positive and obey the triangle "
                           "inequality of its principal moments");
    if (v->cylinder_inertia[0] > 2.0 * v->cylinder_inertia[1] * (1.0 + 1e-9) ||
        v->rod_inertia[0] > 2.0 * v->rod_inertia[1] * (1.0 + 1e-9))
        return refuse(why, "cylinder_inertia, rod_inertia (axial, transverse): axial is at most twice transverse");
    for (int i = 0; i < LEGS; i++) {
        const double *e = v->universal_joint_base_axes + 3 * i;
        const double n = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
        if (!(n > 1e-9))
            return refuse(why, "universal_joint_base_axes, leg %d: the axis has no direction", i + 1);
        for (int k = 0; k < 3; k++) plant->hinge[i][k] = e[k] / n;
        if (!(v->length_min[i] < v->length_max[i]))
            return refuse(why, "leg %d: length_min = %g m must be below length_max = %g m", i + 1, v->length_min[i],
                          v->length_max[i]);
    }
    if (!(v->internal_step > 0.0)) return refuse(why, "internal_step = %g s: it must be positive", v->internal_step);
    const double x = 6.283185307179586 * v->force_bandwidth * v->internal_step;
    plant->decay = x > 0.0 ? decay_of(x) : 0.0;
    plant->decay_half = x > 0.0 ? decay_of(0.5 * x) : 0.0;
    return 0;
}

static int take_initial_state(Plant *plant, char *why)
{
    const Values *v = &plant->v;
    const double *R = v->initial_rotation;
    Equations e;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) {
            const double product = R[3 * i] * R[3 * j] + R[3 * i + 1] * R[3 * j + 1] + R[3 * i + 2] * R[3 * j + 2];
            if (fabs(product - (i == j)) > 1e-6)
                return refuse(why, "initial_rotation is not a rotation: row %d times row %d is %g", i + 1, j + 1,
                              product);
        }
    if (R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]) < 0)
        return refuse(why, "initial_rotation is a reflection: its determinant is -1");
    memcpy(plant->x.p, v->initial_position, sizeof v->initial_position);
    quaternion_of(R, plant->x.q);
    memcpy(plant->x.twist, v->initial_twist, sizeof v->initial_twist);
    memset(plant->applied, 0, sizeof plant->applied);
    plant->steps = 0;
    leg_kinematics(plant, &plant->x, &e);
    for (int i = 0; i < LEGS; i++) {
        if (!(e.l[i] > 1e-6)) return refuse(why, "leg %d has no length at the initial pose", i + 1);
        if (e.l[i] < v->length_min[i] - 1e-6 || e.l[i] > v->length_max[i] + 1e-6)
            return refuse(why, "leg %d is %.6f m long at the initial pose, outside its stroke %.6f to %.6f m", i + 1,
                          e.l[i], v->length_min[i], v->length_max[i]);
    }
    return 0;
}

int plant_initialise(Plant *plant, char *why)
{
    Equations e;
    plant->fresh = 0;
    if (take_parameters(plant, why) != 0 || take_initial_state(plant, why) != 0) return -1;
    if (equations_of_motion(plant, &plant->x, &e) != 0)
        return refuse(why, "the mass matrix at the initial pose is not positive definite");
    return 0;
}

/* dtwist under the drives' forces, viscous friction and contact forces; if `h` > 0, the latter are computed first. */
static int accelerate(const Plant *plant, const Motion *x, const double force[LEGS], double h, double contact[LEGS],
                      double dtwist[6])
{
    double tau[LEGS];
    Equations e;
    if (equations_of_motion(plant, x, &e) != 0) return -1;
    memcpy(dtwist, e.rhs, sizeof e.rhs);
    for (int i = 0; i < LEGS; i++) {
        tau[i] = force[i] - plant->v.viscous_friction[i] * e.dl[i];
        if (h == 0.0) tau[i] += contact[i];
    }
    for (int i = 0; i < LEGS; i++)
        for (int k = 0; k < 6; k++) dtwist[k] += e.J[k][i] * tau[i];
    solve_mass(&e, dtwist);
    if (h > 0.0) contact_forces(&plant->v, &e, h, contact, dtwist);
    return 0;
}

/* d/dt of p, q, twist; q' = (0, w) q / 2 with w in the base frame. */
static void derivative(const Motion *x, const double dtwist[6], Motion *dx)
{
    const double *q = x->q, *w = x->twist + 3;
    memcpy(dx->p, x->twist, sizeof dx->p);
    dx->q[0] = -0.5 * (w[0] * q[1] + w[1] * q[2] + w[2] * q[3]);
    dx->q[1] = 0.5 * (w[0] * q[0] + w[1] * q[3] - w[2] * q[2]);
    dx->q[2] = 0.5 * (w[1] * q[0] + w[2] * q[1] - w[0] * q[3]);
    dx->q[3] = 0.5 * (w[2] * q[0] + w[0] * q[2] - w[1] * q[1]);
    memcpy(dx->twist, dtwist, sizeof dx->twist);
}

/* One internal step: Runge-Kutta 4; the force lag exactly; contact forces held over the step. */
static int internal_step(Plant *plant)
{
    const double h = plant->v.internal_step, *command = plant->v.force;
    double middle[LEGS], end[LEGS], contact[LEGS], dtwist[6];
    Motion k[4], y = plant->x;
    if (plant->decay == 0.0) memcpy(plant->applied, command, sizeof plant->applied);
    for (int i = 0; i < LEGS; i++) {
        const double gap = plant->applied[i] - command[i];
        middle[i] = command[i] + gap * plant->decay_half;
        end[i] = command[i] + gap * plant->decay;
    }
    const double *force[4] = {plant->applied, middle, middle, end}, at[4] = {0.0, 0.5, 0.5, 1.0};
    double *x = (double *)&plant->x, *q = plant->x.q, sum = 0.0;
    for (int s = 0; s < 4; s++) {
        for (int i = 0; s > 0 && i < STATES; i++)
            ((double *)&y)[i] = x[i] + at[s] * h * ((double *)&k[s - 1])[i];
        if (accelerate(plant, &y, force[s], s == 0 ? h : 0.0, contact, dtwist) != 0) return -1;
        derivative(&y, dtwist, &k[s]);
    }

    const double *a = (double *)&k[0], *b = (double *)&k[1], *c = (double *)&k[2], *d = (double *)&k[3];
    for (int i = 0; i < STATES; i++) x[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);
    const double n = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) q[i] *= n;
    memcpy(plant->applied, end, sizeof end);
    plant->steps++;
    for (int i = 0; i < STATES; i++) sum += 0.0 * x[i];
    return sum == 0.0 ? 0 : -1; /* -1 if any is infinite or NaN */
}

int plant_step(Plant *plant, double time, double dt, char *why)
{
    const double h = plant->v.internal_step, now = plant->v.time;
    const double rounding = 1e-15 * (fabs(time) + fabs(now) + dt); /* a few units in the last place of the times */
    if (!isfinite(time) || !isfinite(dt) || dt < 0.0)
        return refuse(why, "a step of %g s from %g s: both must be finite and the step not negative", dt, time);
    if (fabs(time - now) > 1e-9 * h + 4.0 * rounding + 1e-9 * fabs(now))
        return refuse(why, "the step starts at %.12g s but the plant is at %.12g s", time, now);
    const double count = floor(dt / h + 0.5);
    if (fabs(dt - count * h) > 1e-9 * dt + rounding || count > 1e12)
        return refuse(why, "a step of %.12g s is not a multiple of internal_step = %.12g s", dt, h);
    const Motion x = plant->x;
    const long long steps = plant->steps;
    double applied[LEGS];
    memcpy(applied, plant->applied, sizeof applied);
    plant->fresh = 0;
    for (long long k = 0; k < (long long)count; k++)
        if (internal_step(plant) != 0) {
            plant->x = x, plant->steps = steps;
            memcpy(plant->applied, applied, sizeof applied);
            return refuse(why, "the motion diverged within the step from %.12g s: force, friction or stiffness is too "
                               "large for internal_step = %g s, or a leg ran to length zero", now, h);
        }
    plant->v.time = plant->start_time + (double)plant->steps * h;
    return 0;
}

int plant_refresh(Plant *plant, int place, char *why)
{
    Values *v = &plant->v;
    double contact[LEGS];
    Equations e;
    if (place < PLACE(length)) return 0;
    if (plant->mode == INSTANTIATED) return refuse(why, "outputs have no value before initialisation");
    if (plant->mode == BROKEN) return refuse(why, "initialisation failed: reset the instance first");
    if (plant->mode == INITIALISING && !plant->fresh && plant_initialise(plant, why) != 0) return -1;
    if (plant->fresh == 0) {
        leg_kinematics(plant, &plant->x, &e);
        memcpy(v->length, e.l, sizeof e.l);
        memcpy(v->rate, e.dl, sizeof e.dl);
        /* A drive without force lag applies its command at once. */
        memcpy(v->applied_force, plant->decay == 0.0 ? v->force : plant->applied, sizeof plant->applied);
        memcpy(v->position, plant->x.p, sizeof plant->x.p);
        rotation_of(plant->x.q, v->rotation);
        memcpy(v->twist, plant->x.twist, sizeof v->twist);
        plant->fresh = 1;
    }
    if (plant->fresh == 1 && place >= PLACE(acceleration)) {
        if (accelerate(plant, &plant->x, v->applied_force, v->internal_step, contact, v->acceleration) != 0)
            return refuse(why, "the mass matrix is not positive definite at this pose");
        equations_of_motion(plant, &plant->x, &e);
        for (int i = 0; i < LEGS; i++) {
            double ddl = e.bias[i];
            for (int k = 0; k < 6; k++) ddl += e.J[k][i] * v->acceleration[k];
            v->rod_force[i] = v->applied_force[i] - v->viscous_friction[i] * e.dl[i] + contact[i] -
                              v->reflected_mass[i] * ddl;
        }
        energies(plant);
        plant->fresh = 2;
    }
    return 0;
}
