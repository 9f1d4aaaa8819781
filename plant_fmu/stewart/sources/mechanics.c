/* Newton-Euler equations of a Stewart-Gough platform with rigid legs.
 *
 * Leg i, with u = dB/dt, dl = s.u, ds = (u - s dl)/l, and w = d2B/dt2 the acceleration of the platform joint:
 *   s.w = ddl - l |ds|^2,    w_perp = 2 dl ds + l dds_perp.
 * The leg swings about its base joint with the moment of inertia
 *   I = I_cylinder + m1 c1^2 + I_rod + m2 (l - c2)^2,    dI/dt = 2 m2 (l - c2) dl
 * (c1 from the base joint, c2 from the platform joint). Angular momentum about the base joint gives the part of
 * the force F on the leg at B that is normal to it; the rod's momentum along s gives the rest:
 *   l F_perp = I dds_perp + dI/dt ds - (m1 c1 + m2 (l - c2)) g_perp,
 *   s.F      = (m2 + m_reflected) ddl - m2 (l - c2) |ds|^2 - m2 s.g - tau.
 * Eliminating dds and ddl leaves F = Q w + f with Q = qt 1 + (qa - qt) s s^T, qa = m2 + m_reflected, qt = I/l^2.
 * The platform feels -F at B.
 *
 * A leg on a universal joint with base-side hinge e turns about its own axis with
 *   omega_s = y.ds,  y = kappa (e x s),  kappa = (e.s)/(1 - (e.s)^2),
 * because its angular velocity stays in the plane of the two hinges. The joint's moment, normal to both hinges,
 * drives that spin and reacts on the swing:
 *   l F_perp += Ia (domega_s y - omega_s s x ds),   Ia the axial inertia of cylinder and rod together.
 */
#include "mechanics.h"

#include <math.h>
#include <stddef.h>

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double a[3], const double b[3], double c[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static void rotate(const double R[9], const double x[3], double y[3])
{
    y[0] = R[0] * x[0] + R[1] * x[1] + R[2] * x[2];
    y[1] = R[3] * x[0] + R[4] * x[1] + R[5] * x[2];
    y[2] = R[6] * x[0] + R[7] * x[1] + R[8] * x[2];
}

void rotation_of(const double q[4], double R[9])
{
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double n = 2.0 / (w * w + x * x + y * y + z * z);
    const double xx = n * x * x, yy = n * y * y, zz = n * z * z;
    const double xy = n * x * y, xz = n * x * z, yz = n * y * z;
    const double wx = n * w * x, wy = n * w * y, wz = n * w * z;
    R[0] = 1.0 - yy - zz, R[1] = xy - wz, R[2] = xz + wy;
    R[3] = xy + wz, R[4] = 1.0 - xx - zz, R[5] = yz - wx;
    R[6] = xz - wy, R[7] = yz + wx, R[8] = 1.0 - xx - yy;
}

void quaternion_of(const double R[9], double q[4])
{
    /* From the largest of the four components, so that no small number is divided by. */
    const double trace = R[0] + R[4] + R[8];
    int k = 0;
    double largest = trace;
    for (int i = 0; i < 3; i++) {
        if (R[4 * i] > largest) {
            largest = R[4 * i];
            k = i + 1;
        }
    }
    if (k == 0) {
        q[0] = 1.0 + trace, q[1] = R[7] - R[5], q[2] = R[2] - R[6], q[3] = R[3] - R[1];
    } else if (k == 1) {
        q[0] = R[7] - R[5], q[1] = 1.0 + R[0] - R[4] - R[8], q[2] = R[1] + R[3], q[3] = R[2] + R[6];
    } else if (k == 2) {
        q[0] = R[2] - R[6], q[1] = R[1] + R[3], q[2] = 1.0 + R[4] - R[0] - R[8], q[3] = R[5] + R[7];
    } else {
        q[0] = R[3] - R[1], q[1] = R[2] + R[6], q[2] = R[5] + R[7], q[3] = 1.0 + R[8] - R[0] - R[4];
    }
    const double n = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) q[i] *= n;
}

/* All six legs, component by component: a loop over them is six independent chains, which the processor overlaps. */
typedef struct {
    /* filled by geometry: arm = R b, velocity u of the platform joint; of J, the direction s */
    double arm[3][LEGS], u[3][LEGS], J[6][LEGS], l[LEGS], dl[LEGS];
    /* filled by leg_forces: w x (w x arm), force on the leg without dtwist, ddl without dtwist, qt, qa - qt; J */
    double ds[3][LEGS], cc[3][LEGS], f[6][LEGS], bias[LEGS], qt[LEGS], q[LEGS];
    /* filled by leg_products: qt arm, qt (arm^2 1 - arm arm^T), (qa - qt) J; of f, the moment */
    double h[3][LEGS], turning[3][3][LEGS], qJ[6][LEGS];
} Legs;

static void geometry(const Body *restrict body, const Motion *restrict x, const double R[restrict 9],
                     Legs *restrict legs)
{
    for (int i = 0; i < LEGS; i++) {
        const double b0 = body->b[0][i], b1 = body->b[1][i], b2 = body->b[2][i];
        const double r0 = R[0] * b0 + R[1] * b1 + R[2] * b2;
        const double r1 = R[3] * b0 + R[4] * b1 + R[5] * b2;
        const double r2 = R[6] * b0 + R[7] * b1 + R[8] * b2;
        double s0 = x->p[0] + r0 - body->a[0][i];
        double s1 = x->p[1] + r1 - body->a[1][i];
        double s2 = x->p[2] + r2 - body->a[2][i];
        const double l = sqrt(s0 * s0 + s1 * s1 + s2 * s2), inverse = 1.0 / l;
        s0 *= inverse, s1 *= inverse, s2 *= inverse;
        const double u0 = x->v[0] + (x->w[1] * r2 - x->w[2] * r1);
        const double u1 = x->v[1] + (x->w[2] * r0 - x->w[0] * r2);
        const double u2 = x->v[2] + (x->w[0] * r1 - x->w[1] * r0);
        legs->arm[0][i] = r0, legs->arm[1][i] = r1, legs->arm[2][i] = r2;
        legs->J[0][i] = s0, legs->J[1][i] = s1, legs->J[2][i] = s2;
        legs->u[0][i] = u0, legs->u[1][i] = u1, legs->u[2][i] = u2;
        legs->l[i] = l, legs->dl[i] = s0 * u0 + s1 * u1 + s2 * u2;
    }
}

void leg_kinematics(const Body *body, const Motion *x, double l[LEGS], double dl[LEGS])
{
    double R[9];
    Legs legs;
    rotation_of(x->q, R);
    geometry(body, x, R, &legs);
    for (int i = 0; i < LEGS; i++) l[i] = legs.l[i], dl[i] = legs.dl[i];
}

/* R I R^T, symmetric. */
static void rotated_inertia(const double R[9], const double I[9], double out[9])
{
    double T[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            T[3 * i + j] = R[3 * i] * I[j] + R[3 * i + 1] * I[3 + j] + R[3 * i + 2] * I[6 + j];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++)
            out[3 * i + j] = out[3 * j + i] =
                T[3 * i] * R[3 * j] + T[3 * i + 1] * R[3 * j + 1] + T[3 * i + 2] * R[3 * j + 2];
}

/* M = L D L^T in place of the lower triangle; d holds 1/D. */
static int factorise(double L[6][6], double d[6])
{
    for (int j = 0; j < 6; j++) {
        double t[6], D = L[j][j];
        for (int k = 0; k < j; k++) {
            t[k] = L[j][k];
            L[j][k] *= d[k];
            D -= t[k] * L[j][k];
        }
        if (!(D > 0.0)) return -1;
        d[j] = 1.0 / D;
        for (int i = j + 1; i < 6; i++) {
            double sum = L[i][j];
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
            L[i][j] = sum;
        }
    }
    return 0;
}

void solve_mass(const Equations *e, const double r[6], double y[6])
{
    for (int i = 0; i < 6; i++) {
        double sum = r[i];
        for (int k = 0; k < i; k++) sum -= e->L[i][k] * y[k];
        y[i] = sum;
    }
    for (int i = 0; i < 6; i++) y[i] *= e->d[i];
    for (int i = 5; i >= 0; i--) {
        double sum = y[i];
        for (int k = i + 1; k < 6; k++) sum -= e->L[k][i] * y[k];
        y[i] = sum;
    }
}

/* Adds Q += Ia y y^T / l^2 and its force for one spinning leg. */
static void add_spin(const Body *body, int i, Legs *legs, double M[6][6])
{
    const double s[3] = {legs->J[0][i], legs->J[1][i], legs->J[2][i]};
    const double arm[3] = {legs->arm[0][i], legs->arm[1][i], legs->arm[2][i]};
    const double ds[3] = {legs->ds[0][i], legs->ds[1][i], legs->ds[2][i]};
    const double cc[3] = {legs->cc[0][i], legs->cc[1][i], legs->cc[2][i]};
    const double l = legs->l[i], dl = legs->dl[i];
    const double Ia = body->cylinder_axial + body->rod_axial;
    const double *e = body->hinge[i];
    const double c = dot(e, s), dc = dot(e, ds), D = 1.0 - c * c, kappa = c / D;
    double exs[3], y[3], n[6], sxds[3];
    cross(e, s, exs);
    cross(s, ds, sxds);
    for (int k = 0; k < 3; k++) y[k] = kappa * exs[k];
    const double spin = dot(y, ds);
    /* domega_s without the part that w brings: y.dds = (y.w - 2 dl y.ds)/l and dy.ds = dkappa (e x s).ds */
    const double drift = dc * (1.0 + c * c) / (D * D) * dot(exs, ds) - 2.0 * dl * spin / l + dot(y, cc) / l;
    for (int k = 0; k < 3; k++) legs->f[k][i] += Ia / l * (drift * y[k] - spin * sxds[k]);
    for (int k = 0; k < 3; k++) n[k] = y[k] / l;
    cross(arm, n, n + 3);
    for (int r = 0; r < 6; r++)
        for (int k = 0; k <= r; k++) M[r][k] += Ia * n[r] * n[k];
}

/* What the legs are at rest and in motion, without the platform's acceleration. */
static void leg_forces(const Body *restrict body, const Motion *restrict x, Legs *restrict legs)
{
    const double m1 = body->cylinder_mass, m2 = body->rod_mass;
    const double c1 = body->cylinder_com, c2 = body->rod_com;
    const double I0 = body->cylinder_transverse + m1 * c1 * c1 + body->rod_transverse;
    const double g0 = body->gravity[0], g1 = body->gravity[1], g2 = body->gravity[2];
    const double w0 = x->w[0], w1 = x->w[1], w2 = x->w[2];
    for (int i = 0; i < LEGS; i++) {
        const double r0 = legs->arm[0][i], r1 = legs->arm[1][i], r2 = legs->arm[2][i];
        const double s0 = legs->J[0][i], s1 = legs->J[1][i], s2 = legs->J[2][i];
        const double u0 = legs->u[0][i], u1 = legs->u[1][i], u2 = legs->u[2][i], l = legs->l[i], dl = legs->dl[i];
        const double t0 = u0 - x->v[0], t1 = u1 - x->v[1], t2 = u2 - x->v[2];
        const double cc0 = w1 * t2 - w2 * t1, cc1 = w2 * t0 - w0 * t2, cc2 = w0 * t1 - w1 * t0;
        const double inverse = 1.0 / l;
        const double ds0 = (u0 - s0 * dl) * inverse, ds1 = (u1 - s1 * dl) * inverse, ds2 = (u2 - s2 * dl) * inverse;
        const double dsds = ds0 * ds0 + ds1 * ds1 + ds2 * ds2;
        const double cs = cc0 * s0 + cc1 * s1 + cc2 * s2, gs = g0 * s0 + g1 * s1 + g2 * s2;
        const double out = l - c2, m2out = m2 * out;
        const double qa = m2 + body->reflected_mass[i], qt = (I0 + m2out * out) * inverse * inverse;
        const double weight = (m1 * c1 + m2out) * inverse; /* gravity's share at B, normal to the leg */
        const double bias = cs + l * dsds;
        const double axial = qa * bias - m2out * dsds - m2 * gs - qt * cs + weight * gs;
        const double along = 2.0 * dl * (m2out * inverse - qt);
        legs->ds[0][i] = ds0, legs->ds[1][i] = ds1, legs->ds[2][i] = ds2;
        legs->cc[0][i] = cc0, legs->cc[1][i] = cc1, legs->cc[2][i] = cc2;
        legs->f[0][i] = s0 * axial + qt * cc0 + ds0 * along - weight * g0;
        legs->f[1][i] = s1 * axial + qt * cc1 + ds1 * along - weight * g1;
        legs->f[2][i] = s2 * axial + qt * cc2 + ds2 * along - weight * g2;
        legs->J[3][i] = r1 * s2 - r2 * s1;
        legs->J[4][i] = r2 * s0 - r0 * s2;
        legs->J[5][i] = r0 * s1 - r1 * s0;
        legs->bias[i] = bias, legs->qt[i] = qt, legs->q[i] = qa - qt;
    }
}

/* What the legs add to the platform's equations. */
static void leg_products(Legs *restrict legs)
{
    for (int i = 0; i < LEGS; i++) {
        const double r0 = legs->arm[0][i], r1 = legs->arm[1][i], r2 = legs->arm[2][i], qt = legs->qt[i], q = legs->q[i];
        const double f0 = legs->f[0][i], f1 = legs->f[1][i], f2 = legs->f[2][i];
        const double h0 = qt * r0, h1 = qt * r1, h2 = qt * r2, aa = h0 * r0 + h1 * r1 + h2 * r2;
        legs->f[3][i] = r1 * f2 - r2 * f1;
        legs->f[4][i] = r2 * f0 - r0 * f2;
        legs->f[5][i] = r0 * f1 - r1 * f0;
        legs->h[0][i] = h0, legs->h[1][i] = h1, legs->h[2][i] = h2;
        legs->turning[0][0][i] = aa - h0 * r0;
        legs->turning[1][0][i] = -(h1 * r0), legs->turning[1][1][i] = aa - h1 * r1;
        legs->turning[2][0][i] = -(h2 * r0), legs->turning[2][1][i] = -(h2 * r1), legs->turning[2][2][i] = aa - h2 * r2;
        legs->qJ[0][i] = q * legs->J[0][i], legs->qJ[1][i] = q * legs->J[1][i], legs->qJ[2][i] = q * legs->J[2][i];
        legs->qJ[3][i] = q * legs->J[3][i], legs->qJ[4][i] = q * legs->J[4][i], legs->qJ[5][i] = q * legs->J[5][i];
    }
}

/* sum + part_1 + a_1 b_1 + part_2 + a_2 b_2 ..., leg after leg; without part where it is NULL. */
static inline double summed(double sum, const double *part, const double a[LEGS], const double b[LEGS])
{
    for (int i = 0; i < LEGS; i++) {
        if (part) sum += part[i];
        sum += a[i] * b[i];
    }
    return sum;
}

int equations_of_motion(const Body *body, const Motion *x, const double wrench[6], Equations *e)
{
    const double m = body->mass, *g = body->gravity;
    double rc[3], t[3], cc[3], I[9], force[3], moment[3];
    double(*M)[6] = e->L;
    Legs legs;

    /* Platform alone, about its origin: m (dv + dw x rc + w x (w x rc)) = m g + F;
     * rc x m(...) + I dw + w x I w = rc x m g + moment. */
    rotation_of(x->q, e->R);
    rotate(e->R, body->com, rc);
    rotated_inertia(e->R, body->inertia, I);
    cross(x->w, rc, t);
    cross(x->w, t, cc);
    for (int k = 0; k < 3; k++) force[k] = m * (g[k] - cc[k]);
    cross(rc, force, moment);
    rotate(I, x->w, t);
    cross(x->w, t, cc);
    for (int k = 0; k < 3; k++) {
        e->rhs[k] = wrench[k] + force[k];
        e->rhs[k + 3] = wrench[k + 3] + moment[k] - cc[k];
    }
    const double rr = m * dot(rc, rc);
    double h[3] = {m * rc[0], m * rc[1], m * rc[2]};
    M[3][3] = I[0] + rr - h[0] * rc[0];
    M[4][3] = I[3] - h[1] * rc[0], M[4][4] = I[4] + rr - h[1] * rc[1];
    M[5][3] = I[6] - h[2] * rc[0], M[5][4] = I[7] - h[2] * rc[1], M[5][5] = I[8] + rr - h[2] * rc[2];
    M[0][0] = M[1][1] = M[2][2] = m;
    M[1][0] = M[2][0] = M[2][1] = 0.0;
    for (int r = 3; r < 6; r++)
        for (int k = 0; k < 3; k++) M[r][k] = 0.0;

    geometry(body, x, e->R, &legs);
    leg_forces(body, x, &legs);
    for (int i = 0; i < LEGS; i++) {
        if (!(legs.l[i] > 1e-9)) return -1;
        if (body->universal) add_spin(body, i, &legs, M);
        e->l[i] = legs.l[i], e->dl[i] = legs.dl[i], e->bias[i] = legs.bias[i];
        for (int k = 0; k < 6; k++) e->J[i][k] = legs.J[k][i];
    }
    /* A^T Q A with A = [1, -[arm]x]: the isotropic part, then qa - qt times J J^T. */
    leg_products(&legs);
    for (int i = 0; i < LEGS; i++) {
        for (int k = 0; k < 6; k++) e->rhs[k] -= legs.f[k][i];
        for (int k = 0; k < 3; k++) h[k] += legs.h[k][i];
    }
    for (int k = 0; k < 3; k++) {
        M[k][k] = summed(M[k][k], legs.qt, legs.qJ[k], legs.J[k]);
        for (int r = k + 1; r < 6; r++) M[r][k] = summed(M[r][k], NULL, legs.qJ[r], legs.J[k]);
        for (int r = k; r < 3; r++)
            M[r + 3][k + 3] = summed(M[r + 3][k + 3], legs.turning[r][k], legs.qJ[r + 3], legs.J[k + 3]);
    }
    /* [h]x: coupling of rotation and translation by the mass-weighted arms. */
    M[3][1] -= h[2], M[3][2] += h[1];
    M[4][0] += h[2], M[4][2] -= h[0];
    M[5][0] -= h[1], M[5][1] += h[0];
    return factorise(M, e->d);
}

void energies(const Body *body, const Motion *x, double *kinetic, double *potential)
{
    const double m = body->mass, m1 = body->cylinder_mass, m2 = body->rod_mass;
    const double c1 = body->cylinder_com, c2 = body->rod_com;
    double R[9], rc[3], t[3], I[9], Iw[3];
    Legs legs;
    rotation_of(x->q, R);
    rotate(R, body->com, rc);
    cross(x->w, rc, t);
    for (int k = 0; k < 3; k++) t[k] += x->v[k];
    rotated_inertia(R, body->inertia, I);
    rotate(I, x->w, Iw);
    double T = m * dot(t, t) + dot(x->w, Iw);
    for (int k = 0; k < 3; k++) t[k] = x->p[k] + rc[k];
    double V = -m * dot(body->gravity, t);
    geometry(body, x, R, &legs);
    for (int i = 0; i < LEGS; i++) {
        const double s[3] = {legs.J[0][i], legs.J[1][i], legs.J[2][i]}, l = legs.l[i], dl = legs.dl[i];
        double ds[3], exs[3], at1[3], at2[3];
        for (int k = 0; k < 3; k++) ds[k] = (legs.u[k][i] - s[k] * dl) / l;
        const double out = l - c2;
        const double swing = body->cylinder_transverse + m1 * c1 * c1 + body->rod_transverse + m2 * out * out;
        T += swing * dot(ds, ds) + (m2 + body->reflected_mass[i]) * dl * dl;
        if (body->universal) {
            const double c = dot(body->hinge[i], s);
            cross(body->hinge[i], s, exs);
            const double spin = c / (1.0 - c * c) * dot(exs, ds);
            T += (body->cylinder_axial + body->rod_axial) * spin * spin;
        }
        for (int k = 0; k < 3; k++) {
            at1[k] = body->a[k][i] + c1 * s[k];
            at2[k] = body->a[k][i] + out * s[k];
        }
        V -= m1 * dot(body->gravity, at1) + m2 * dot(body->gravity, at2);
    }
    *kinetic = 0.5 * T;
    *potential = V;
}
