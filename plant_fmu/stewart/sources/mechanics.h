/* Rigid-body equations of the platform and its six legs.
 *
 * Mathematics only. No FMI, no allocation, no state of its own, no library beyond sqrt.
 *
 * Notation: x_base = p + R x_platform; twist = [v of the platform origin; omega], base frame;
 * leg i runs from base joint a_i to platform joint B_i = p + R b_i, l its length, s its direction, tau > 0 extends.
 */
#ifndef STEWART_MECHANICS_H
#define STEWART_MECHANICS_H

#define LEGS 6

/* What does not change while a simulation runs. SI. */
typedef struct {
    double a[3][LEGS], b[3][LEGS]; /* base joints in the base frame, platform joints in the platform frame */
    double mass, com[3], inertia[9];
    double cylinder_mass, cylinder_com, cylinder_axial, cylinder_transverse;
    double rod_mass, rod_com, rod_axial, rod_transverse;
    double gravity[3];
    double reflected_mass[LEGS];
    double hinge[LEGS][3]; /* unit vectors: base-side hinge of each universal joint */
    int universal;         /* 1: legs hang on universal joints and spin with them */
} Body;

/* Pose as position and unit quaternion (scalar first), and twist. */
typedef struct {
    double p[3], q[4], v[3], w[3];
} Motion;

/* The equations of motion at one state: M dtwist = rhs + J^T tau, and ddl = J dtwist + bias. */
typedef struct {
    double R[9];
    double l[LEGS], dl[LEGS];
    double J[LEGS][6]; /* row i: [s, (R b) x s] */
    double bias[LEGS];
    double rhs[6];
    double L[6][6], d[6]; /* M = L diag(1/d) L^T, L unit lower triangular */
} Equations;

void rotation_of(const double q[4], double R[9]);
void quaternion_of(const double R[9], double q[4]);

/* Lengths and rates only. */
void leg_kinematics(const Body *body, const Motion *x, double l[LEGS], double dl[LEGS]);

/* Fill `e`. Returns 0, or -1 where the mass matrix is not positive definite or a leg has no length. */
int equations_of_motion(const Body *body, const Motion *x, const double wrench[6], Equations *e);

/* y = M^-1 r. */
void solve_mass(const Equations *e, const double r[6], double y[6]);

/* Kinetic energy, and potential energy with its zero level through the origin of the base frame. */
void energies(const Body *body, const Motion *x, double *kinetic, double *potential);

#endif
