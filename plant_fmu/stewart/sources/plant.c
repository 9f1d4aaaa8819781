/* Integration and outputs. */
#include "plant.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

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
    memcpy(plant->v, START, sizeof plant->v);
    plant->mode = INSTANTIATED;
}

static void name_of(int offset, char text[64])
{
    const int i = OWNER[offset];
    const int k = offset - VARIABLES[i].offset, columns = VARIABLES[i].columns;
    if (VARIABLES[i].count == 1) snprintf(text, 64, "%s", VARIABLES[i].name);
    else if (columns) snprintf(text, 64, "%s[%d,%d]", VARIABLES[i].name, k / columns + 1, k % columns + 1);
    else snprintf(text, 64, "%s[%d]", VARIABLES[i].name, k + 1);
}

int plant_check(const Plant *plant, int offset, double value, char *why)
{
    char name[64];
    const Variable *variable = &VARIABLES[OWNER[offset]];
    const int settable = variable->causality == INPUT || variable->causality == PARAMETER;
    if (settable && (plant->mode < STEPPING || (plant->mode == STEPPING && variable->causality == INPUT)) &&
        isfinite(value) && value >= variable->min && value <= variable->max)
        return 0;
    name_of(offset, name);
    if (!settable) return refuse(why, "%s is neither an input nor a parameter: it cannot be set", name);
    if (plant->mode >= TERMINATED)
        return refuse(why, "%s cannot be set after termination: reset the instance first", name);
    if (plant->mode == STEPPING && variable->causality == PARAMETER)
        return refuse(why, "parameter %s is fixed: set it before initialisation ends", name);
    if (!isfinite(value)) return refuse(why, "%s was given a value that is not finite", name);
    return refuse(why, "%s = %g lies outside %g to %g", name, value, variable->min, variable->max);
}

void plant_store(Plant *plant, int offset, double value)
{
    plant->v[offset] = value;
    plant->fresh = 0;
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
    const double *v = plant->v;
    Body *body = &plant->body;
    for (int i = 0; i < LEGS; i++)
        for (int k = 0; k < 3; k++) {
            body->a[k][i] = v[V_base_joints + 3 * i + k];
            body->b[k][i] = v[V_platform_joints + 3 * i + k];
        }
    body->mass = v[V_mass];
    memcpy(body->com, v + V_com, sizeof body->com);
    memcpy(body->inertia, v + V_inertia, sizeof body->inertia);
    body->cylinder_mass = v[V_cylinder_mass], body->cylinder_com = v[V_cylinder_com];
    body->cylinder_axial = v[V_cylinder_inertia], body->cylinder_transverse = v[V_cylinder_inertia + 1];
    body->rod_mass = v[V_rod_mass], body->rod_com = v[V_rod_com];
    body->rod_axial = v[V_rod_inertia], body->rod_transverse = v[V_rod_inertia + 1];
    memcpy(body->gravity, v + V_gravity, sizeof body->gravity);
    memcpy(body->reflected_mass, v + V_reflected_mass, sizeof body->reflected_mass);
    body->universal = v[V_leg_spin] > 1.5;
    memcpy(plant->stops.length_min, v + V_length_min, sizeof plant->stops.length_min);
    memcpy(plant->stops.length_max, v + V_length_max, sizeof plant->stops.length_max);
    plant->stops.stop_stiffness = v[V_stop_stiffness], plant->stops.stop_damping = v[V_stop_damping];

    if (!(body->mass > 0.0)) return refuse(why, "mass = %g kg: it must be positive", body->mass);
    if (!physical(body->inertia))
        return refuse(why, "inertia is no inertia of a body: it must be symmetric, positive and obey the triangle "
                           "inequality of its principal moments");
    if (body->cylinder_axial > 2.0 * body->cylinder_transverse * (1.0 + 1e-9) ||
        body->rod_axial > 2.0 * body->rod_transverse * (1.0 + 1e-9))
        return refuse(why, "cylinder_inertia, rod_inertia (axial, transverse): axial is at most twice transverse");
    for (int i = 0; i < LEGS; i++) {
        const double *e = v + V_universal_joint_base_axes + 3 * i;
        const double n = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
        if (!(n > 1e-9))
            return refuse(why, "universal_joint_base_axes, leg %d: the axis has no direction", i + 1);
        for (int k = 0; k < 3; k++) body->hinge[i][k] = e[k] / n;
        if (!(plant->stops.length_min[i] < plant->stops.length_max[i]))
            return refuse(why, "leg %d: length_min = %g m must be below length_max = %g m", i + 1,
                          plant->stops.length_min[i], plant->stops.length_max[i]);
    }
    if (!(v[V_internal_step] > 0.0)) return refuse(why, "internal_step = %g s: it must be positive", v[V_internal_step]);
    const double x = 6.283185307179586 * v[V_force_bandwidth] * v[V_internal_step];
    plant->decay = x > 0.0 ? decay_of(x) : 0.0;
    plant->decay_half = x > 0.0 ? decay_of(0.5 * x) : 0.0;
    return 0;
}

static int take_initial_state(Plant *plant, char *why)
{
    const double *R = plant->v + V_initial_rotation;
    double l[LEGS], dl[LEGS];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) {
            const double product = R[3 * i] * R[3 * j] + R[3 * i + 1] * R[3 * j + 1] + R[3 * i + 2] * R[3 * j + 2];
            if (fabs(product - (i == j)) > 1e-6)
                return refuse(why, "initial_rotation is no rotation: row %d times row %d is %g", i + 1, j + 1, product);
        }
    if (R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]) < 0)
        return refuse(why, "initial_rotation is a reflection: its determinant is -1");
    memcpy(plant->x.p, plant->v + V_initial_position, sizeof plant->x.p);
    quaternion_of(R, plant->x.q);
    memcpy(plant->x.v, plant->v + V_initial_twist, sizeof plant->x.v);
    memcpy(plant->x.w, plant->v + V_initial_twist + 3, sizeof plant->x.w);
    memset(plant->applied, 0, sizeof plant->applied);
    plant->steps = 0;
    leg_kinematics(&plant->body, &plant->x, l, dl);
    for (int i = 0; i < LEGS; i++) {
        if (!(l[i] > 1e-6)) return refuse(why, "leg %d has no length at the initial pose", i + 1);
        if (l[i] < plant->stops.length_min[i] - 1e-6 || l[i] > plant->stops.length_max[i] + 1e-6)
            return refuse(why, "leg %d is %.6f m long at the initial pose, outside its stroke %.6f to %.6f m", i + 1,
                          l[i], plant->stops.length_min[i], plant->stops.length_max[i]);
    }
    return 0;
}

int plant_initialise(Plant *plant, char *why)
{
    Equations e;
    plant->fresh = 0;
    if (take_parameters(plant, why) != 0 || take_initial_state(plant, why) != 0) return -1;
    if (equations_of_motion(&plant->body, &plant->x, plant->v + V_wrench, &e) != 0)
        return refuse(why, "the mass matrix at the initial pose is not positive definite");
    return 0;
}

/* dtwist under the drives' forces, viscous friction and, where `h` > 0, the contact forces, which are left in tau. */
static int accelerate(const Plant *plant, const Motion *x, const double force[LEGS], double h, double contact[LEGS],
                      double dtwist[6], Equations *e)
{
    double r[6];
    if (equations_of_motion(&plant->body, x, plant->v + V_wrench, e) != 0) return -1;
    memcpy(r, e->rhs, sizeof r);
    for (int i = 0; i < LEGS; i++) {
        double tau = force[i] - plant->v[V_viscous_friction + i] * e->dl[i];
        if (h == 0.0) tau += contact[i];
        for (int k = 0; k < 6; k++) r[k] += e->J[i][k] * tau;
    }
    solve_mass(e, r, dtwist);
    if (h > 0.0) {
        double free[6];
        memcpy(free, dtwist, sizeof free);
        memset(contact, 0, LEGS * sizeof *contact);
        contact_forces(&plant->stops, e, plant->friction, free, h, contact, dtwist);
    }
    return 0;
}

/* d/dt of p, q, v, w; q' = (0, w) q / 2 with w in the base frame. */
static void derivative(const Motion *x, const double dtwist[6], Motion *dx)
{
    const double *q = x->q, *w = x->w;
    for (int k = 0; k < 3; k++) dx->p[k] = x->v[k];
    dx->q[0] = -0.5 * (w[0] * q[1] + w[1] * q[2] + w[2] * q[3]);
    dx->q[1] = 0.5 * (w[0] * q[0] + w[1] * q[3] - w[2] * q[2]);
    dx->q[2] = 0.5 * (w[1] * q[0] + w[2] * q[1] - w[0] * q[3]);
    dx->q[3] = 0.5 * (w[2] * q[0] + w[0] * q[2] - w[1] * q[1]);
    for (int k = 0; k < 3; k++) dx->v[k] = dtwist[k];
    for (int k = 0; k < 3; k++) dx->w[k] = dtwist[k + 3];
}

#define STATES ((int)(sizeof(Motion) / sizeof(double)))

static void advance(const Motion *x, const Motion *dx, double h, Motion *y)
{
    const double *a = (const double *)x, *b = (const double *)dx;
    double *c = (double *)y;
    for (int k = 0; k < STATES; k++) c[k] = a[k] + h * b[k];
}

/* One internal step: Runge-Kutta 4; the force lag exactly; contact forces held over the step. */
static int internal_step(Plant *plant)
{
    const double h = plant->v[V_internal_step], *command = plant->v + V_force;
    double middle[LEGS], end[LEGS], contact[LEGS], dtwist[6];
    Motion k[4], y = plant->x;
    Equations e;
    if (plant->decay == 0.0) memcpy(plant->applied, command, sizeof plant->applied);
    for (int i = 0; i < LEGS; i++) {
        const double gap = plant->applied[i] - command[i];
        middle[i] = command[i] + gap * plant->decay_half;
        end[i] = command[i] + gap * plant->decay;
    }
    const double *force[4] = {plant->applied, middle, middle, end}, at[4] = {0.0, 0.5, 0.5, 1.0};
    for (int s = 0; s < 4; s++) {
        if (s > 0) advance(&plant->x, &k[s - 1], at[s] * h, &y);
        if (accelerate(plant, &y, force[s], s == 0 ? h : 0.0, contact, dtwist, &e) != 0) return -1;
        derivative(&y, dtwist, &k[s]);
    }

    double *x = (double *)&plant->x, *q = plant->x.q;
    const double *a = (double *)&k[0], *b = (double *)&k[1], *c = (double *)&k[2], *d = (double *)&k[3];
    for (int i = 0; i < STATES; i++) x[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);
    const double n = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) q[i] *= n;
    memcpy(plant->applied, end, sizeof end);
    plant->steps++;
    return 0;
}

static void take_friction(Plant *plant)
{
    for (int i = 0; i < LEGS; i++)
        plant->friction[i] = plant->v[V_coulomb_friction + i] + plant->v[V_brake + i] * plant->v[V_brake_force + i];
}

int plant_step(Plant *plant, double time, double dt, char *why)
{
    const double h = plant->v[V_internal_step];
    const double now = plant->start_time + (double)plant->steps * h;
    const double rounding = 1e-15 * (fabs(time) + fabs(now) + dt); /* a few units in the last place of the times */
    if (!isfinite(time) || !isfinite(dt) || dt < 0.0)
        return refuse(why, "a step of %g s from %g s: both must be finite and the step not negative", dt, time);
    if (fabs(time - now) > 1e-9 * h + 4.0 * rounding + 1e-9 * fabs(now))
        return refuse(why, "the step starts at %.12g s but the plant stands at %.12g s", time, now);
    const double count = floor(dt / h + 0.5);
    if (fabs(dt - count * h) > 1e-9 * dt + rounding || count > 1e12)
        return refuse(why, "a step of %.12g s is no multiple of internal_step = %.12g s", dt, h);
    const Motion x = plant->x;
    const long long steps = plant->steps;
    double applied[LEGS];
    memcpy(applied, plant->applied, sizeof applied);
    take_friction(plant);
    plant->fresh = 0;
    for (long long k = 0; k < (long long)count; k++) {
        double sum = 0.0;
        int failed = internal_step(plant);
        for (int j = 0; j < STATES; j++) sum += 0.0 * ((const double *)&plant->x)[j];
        if (failed || sum != 0.0) {
            plant->x = x, plant->steps = steps;
            memcpy(plant->applied, applied, sizeof applied);
            return refuse(why, "the motion diverged within the step from %.12g s: force, friction or stiffness is too "
                               "large for internal_step = %g s, or a leg ran to length zero", now, h);
        }
    }
    return 0;
}

static int refresh_accelerations(Plant *plant, char *why)
{
    double contact[LEGS], force[LEGS];
    Equations e;
    take_friction(plant);
    memcpy(force, plant->v + V_applied_force, sizeof force);
    if (accelerate(plant, &plant->x, force, plant->v[V_internal_step], contact, plant->v + V_acceleration, &e) != 0)
        return refuse(why, "the mass matrix is not positive definite at this pose");
    energies(&plant->body, &plant->x, plant->v + V_kinetic_energy, plant->v + V_potential_energy);
    return 0;
}

int plant_refresh(Plant *plant, int offset, char *why)
{
    double *v = plant->v;
    if (offset == V_time) {
        v[V_time] = plant->start_time + (double)plant->steps * v[V_internal_step];
        return 0;
    }
    if (offset < FIRST_OUTPUT) return 0;
    if (plant->mode == INSTANTIATED)
        return refuse(why, "outputs have no value before initialisation");
    if (plant->mode == BROKEN) return refuse(why, "initialisation failed: reset the instance first");
    if (plant->mode == INITIALISING && !plant->fresh && plant_initialise(plant, why) != 0) return -1;
    if (plant->fresh == 0) {
        leg_kinematics(&plant->body, &plant->x, v + V_length, v + V_rate);
        /* An ideal drive applies its command at once. */
        memcpy(v + V_applied_force, plant->decay == 0.0 ? v + V_force : plant->applied, sizeof plant->applied);
        memcpy(v + V_position, plant->x.p, sizeof plant->x.p);
        rotation_of(plant->x.q, v + V_rotation);
        memcpy(v + V_twist, plant->x.v, sizeof plant->x.v);
        memcpy(v + V_twist + 3, plant->x.w, sizeof plant->x.w);
        plant->fresh = 1;
    }
    if (plant->fresh == 1 && offset >= V_acceleration) {
        if (refresh_accelerations(plant, why) != 0) return -1;
        plant->fresh = 2;
    }
    return 0;
}
