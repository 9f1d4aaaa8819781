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
#include "plant.h"

#include <math.h>

typedef struct {
    double x, y, z;
} Vec;

static inline Vec vec(const double a[3]) { return (Vec){a[0], a[1], a[2]}; }
static inline Vec plus(Vec a, Vec b) { return (Vec){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline Vec minus(Vec a, Vec b) { return (Vec){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline Vec times(double k, Vec a) { return (Vec){k * a.x, k * a.y, k * a.z}; }
static inline Vec over(Vec a, double k) { return (Vec){a.x / k, a.y / k, a.z / k}; }
static inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline Vec cross(Vec a, Vec b)
{
    return (Vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline Vec rotate(const double R[9], Vec a)
{
    return (Vec){dot(vec(R), a), dot(vec(R + 3), a), dot(vec(R + 6), a)};
}

/* Read and write leg i in an array by component, then leg. */
static inline Vec leg(double (*a)[LEGS], int i) { return (Vec){a[0][i], a[1][i], a[2][i]}; }
static inline void put(double (*a)[LEGS], int i, Vec b) { a[0][i] = b.x, a[1][i] = b.y, a[2][i] = b.z; }

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
    /* q times each of its components; the largest is the divisor, so that no divisor is small. */
    const double trace = R[0] + R[4] + R[8];
    const double products[4][4] = {{1.0 + trace, R[7] - R[5], R[2] - R[6], R[3] - R[1]},
                                   {R[7] - R[5], 1.0 + R[0] - R[4] - R[8], R[1] + R[3], R[2] + R[6]},
                                   {R[2] - R[6], R[1] + R[3], 1.0 + R[4] - R[0] - R[8], R[5] + R[7]},
                                   {R[3] - R[1], R[2] + R[6], R[5] + R[7], 1.0 + R[8] - R[0] - R[4]}};
    const double size[4] = {trace, R[0], R[4], R[8]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (size[i] > size[k]) k = i;
    const double *a = products[k], n = 1.0 / sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3]);
    for (int i = 0; i < 4; i++) q[i] = a[i] * n;
}

static void geometry(const Values *restrict body, const Motion *restrict x, const double R[restrict 9],
                     Equations *restrict e)
{
    for (int i = 0; i < LEGS; i++) {
        const Vec arm = rotate(R, vec(body->platform_joints + 3 * i));
        const Vec along = minus(plus(vec(x->p), arm), vec(body->base_joints + 3 * i));
        const double l = sqrt(dot(along, along));
        const Vec s = times(1.0 / l, along), u = plus(vec(x->twist), cross(vec(x->twist + 3), arm));
        put(e->arm, i, arm), put(e->J, i, s), put(e->u, i, u);
        e->l[i] = l, e->dl[i] = dot(s, u);
    }
}

void leg_kinematics(const Plant *plant, const Motion *x, Equations *e)
{
    double R[9];
    rotation_of(x->q, R);
    geometry(&plant->v, x, R, e);
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

/* M = L D L^T, stored in the lower triangle; d holds 1/D. */
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

void solve_mass(const Equations *e, double y[6])
{
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < i; k++) y[i] -= e->L[i][k] * y[k];
    for (int i = 0; i < 6; i++) y[i] *= e->d[i];
    for (int i = 5; i >= 0; i--)
        for (int k = i + 1; k < 6; k++) y[i] -= e->L[k][i] * y[k];
}

/* Adds Q += Ia y y^T / l^2 and its force for one spinning leg. */
static void add_spin(const Plant *plant, int i, Equations *eq)
{
    const Vec e = vec(plant->hinge[i]), s = leg(eq->J, i), ds = leg(eq->ds, i), exs = cross(e, s);
    const double l = eq->l[i], Ia = plant->v.cylinder_inertia[0] + plant->v.rod_inertia[0];
    const double c = dot(e, s), dc = dot(e, ds), D = 1.0 - c * c, kappa = c / D;
    const Vec y = times(kappa, exs), n = over(y, l), moment = cross(leg(eq->arm, i), n);
    const double spin = dot(y, ds), N[6] = {n.x, n.y, n.z, moment.x, moment.y, moment.z};
    /* domega_s without the part that w brings: y.dds = (y.w - 2 dl y.ds)/l and dy.ds = dkappa (e x s).ds */
    const double drift =
        dc * (1.0 + c * c) / (D * D) * dot(exs, ds) - 2.0 * eq->dl[i] * spin / l + dot(y, leg(eq->cc, i)) / l;
    put(eq->f, i, plus(leg(eq->f, i), times(Ia / l, minus(times(drift, y), times(spin, cross(s, ds))))));
    for (int r = 0; r < 6; r++)
        for (int k = 0; k <= r; k++) eq->L[r][k] += Ia * N[r] * N[k];
}

/* Leg inertias and forces without the platform's acceleration. */
static void leg_forces(const Values *restrict body, const Motion *restrict x, Equations *restrict e)
{
    const double m1 = body->cylinder_mass, m2 = body->rod_mass;
    const double c1 = body->cylinder_com, c2 = body->rod_com;
    const double I0 = body->cylinder_inertia[1] + m1 * c1 * c1 + body->rod_inertia[1];
    const Vec g = vec(body->gravity), v = vec(x->twist), w = vec(x->twist + 3);
    for (int i = 0; i < LEGS; i++) {
        const Vec s = leg(e->J, i), u = leg(e->u, i);
        const double l = e->l[i], dl = e->dl[i], inverse = 1.0 / l;
        const Vec cc = cross(w, minus(u, v)), ds = times(inverse, minus(u, times(dl, s)));
        const double dsds = dot(ds, ds), cs = dot(cc, s), gs = dot(g, s);
        const double out = l - c2, m2out = m2 * out;
        const double qa = m2 + body->reflected_mass[i], qt = (I0 + m2out * out) * inverse * inverse;
        const double weight = (m1 * c1 + m2out) * inverse; /* gravity's share at B, normal to the leg */
        const double bias = cs + l * dsds;
        const double axial = qa * bias - m2out * dsds - m2 * gs - qt * cs + weight * gs;
        const double along = 2.0 * dl * (m2out * inverse - qt);
        put(e->ds, i, ds), put(e->cc, i, cc), put(e->J + 3, i, cross(leg(e->arm, i), s));
        put(e->f, i, minus(plus(plus(times(axial, s), times(qt, cc)), times(along, ds)), times(weight, g)));
        e->bias[i] = bias, e->qt[i] = qt, e->q[i] = qa - qt;
    }
}

/* Contribution of the legs to the platform's equations. */
static void leg_products(Equations *restrict e)
{
    for (int i = 0; i < LEGS; i++) {
        const Vec r = leg(e->arm, i), h = times(e->qt[i], r);
        const double hr = dot(h, r);
        put(e->f + 3, i, cross(r, leg(e->f, i))), put(e->h, i, h);
        put(e->turning[0], i, (Vec){hr - h.x * r.x, -(h.y * r.x), -(h.z * r.x)});
        e->turning[1][1][i] = hr - h.y * r.y, e->turning[1][2][i] = -(h.z * r.y), e->turning[2][2][i] = hr - h.z * r.z;
        put(e->qJ, i, times(e->q[i], leg(e->J, i))), put(e->qJ + 3, i, times(e->q[i], leg(e->J + 3, i)));
    }
}

/* sum + part_1 + a_1 b_1 + part_2 + a_2 b_2 ..., leg after leg; no part if it is NULL. */
static inline double summed(double sum, const double *part, const double a[LEGS], const double b[LEGS])
{
    for (int i = 0; i < LEGS; i++) {
        if (part) sum += part[i];
        sum += a[i] * b[i];
    }
    return sum;
}

int equations_of_motion(const Plant *plant, const Motion *x, Equations *e)
{
    const Values *body = &plant->v;
    const double m = body->mass, *wrench = body->wrench;
    double R[9], I[9], (*M)[6] = e->L;

    /* Platform alone, about its origin: m (dv + dw x rc + w x (w x rc)) = m g + F;
     * rc x m(...) + I dw + w x I w = rc x m g + moment. */
    rotation_of(x->q, R);
    rotated_inertia(R, body->inertia, I);
    const Vec w = vec(x->twist + 3), rc = rotate(R, vec(body->com));
    const Vec force = times(m, minus(vec(body->gravity), cross(w, cross(w, rc))));
    const Vec moment = cross(rc, force), gyro = cross(w, rotate(I, w));
    e->rhs[0] = wrench[0] + force.x, e->rhs[3] = wrench[3] + moment.x - gyro.x;
    e->rhs[1] = wrench[1] + force.y, e->rhs[4] = wrench[4] + moment.y - gyro.y;
    e->rhs[2] = wrench[2] + force.z, e->rhs[5] = wrench[5] + moment.z - gyro.z;
    const double rr = m * dot(rc, rc);
    Vec h = times(m, rc);
    M[3][3] = I[0] + rr - h.x * rc.x;
    M[4][3] = I[3] - h.y * rc.x, M[4][4] = I[4] + rr - h.y * rc.y;
    M[5][3] = I[6] - h.z * rc.x, M[5][4] = I[7] - h.z * rc.y, M[5][5] = I[8] + rr - h.z * rc.z;
    M[0][0] = M[1][1] = M[2][2] = m;
    M[1][0] = M[2][0] = M[2][1] = 0.0;
    for (int r = 3; r < 6; r++)
        for (int k = 0; k < 3; k++) M[r][k] = 0.0;

    geometry(body, x, R, e);
    leg_forces(body, x, e);
    for (int i = 0; i < LEGS; i++)
        if (!(e->l[i] > 1e-9)) return -1;
    if (body->leg_spin > 1.5)
        for (int i = 0; i < LEGS; i++) add_spin(plant, i, e);
    /* A^T Q A with A = [1, -[arm]x]: the isotropic part, then qa - qt times J J^T. */
    leg_products(e);
    for (int i = 0; i < LEGS; i++) {
        for (int k = 0; k < 6; k++) e->rhs[k] -= e->f[k][i];
        h = plus(h, leg(e->h, i));
    }
    for (int k = 0; k < 3; k++) {
        M[k][k] = summed(M[k][k], e->qt, e->qJ[k], e->J[k]);
        for (int r = k + 1; r < 6; r++) M[r][k] = summed(M[r][k], NULL, e->qJ[r], e->J[k]);
        for (int r = k; r < 3; r++)
            M[r + 3][k + 3] = summed(M[r + 3][k + 3], e->turning[k][r], e->qJ[r + 3], e->J[k + 3]);
    }
    /* [h]x: coupling of rotation and translation by the mass-weighted arms. */
    M[3][1] -= h.z, M[3][2] += h.y;
    M[4][0] += h.z, M[4][2] -= h.x;
    M[5][0] -= h.y, M[5][1] += h.x;
    return factorise(M, e->d);
}

void energies(Plant *plant)
{
    const Motion *x = &plant->x;
    Values *body = &plant->v;
    const double m1 = body->cylinder_mass, m2 = body->rod_mass, c1 = body->cylinder_com;
    double R[9], I[9];
    Equations e;
    rotation_of(x->q, R);
    rotated_inertia(R, body->inertia, I);
    const Vec g = vec(body->gravity), w = vec(x->twist + 3), rc = rotate(R, vec(body->com));
    const Vec v = plus(vec(x->twist), cross(w, rc));
    double T = body->mass * dot(v, v) + dot(w, rotate(I, w));
    double V = -body->mass * dot(g, plus(vec(x->p), rc));
    geometry(body, x, R, &e);
    for (int i = 0; i < LEGS; i++) {
        const Vec s = leg(e.J, i), a = vec(body->base_joints + 3 * i), hinge = vec(plant->hinge[i]);
        const double dl = e.dl[i], out = e.l[i] - body->rod_com;
        const Vec ds = over(minus(leg(e.u, i), times(dl, s)), e.l[i]);
        const double swing = body->cylinder_inertia[1] + m1 * c1 * c1 + body->rod_inertia[1] + m2 * out * out;
        T += swing * dot(ds, ds) + (m2 + body->reflected_mass[i]) * dl * dl;
        if (body->leg_spin > 1.5) {
            const double c = dot(hinge, s), spin = c / (1.0 - c * c) * dot(cross(hinge, s), ds);
            T += (body->cylinder_inertia[0] + body->rod_inertia[0]) * spin * spin;
        }
        V -= m1 * dot(g, plus(a, times(c1, s))) + m2 * dot(g, plus(a, times(out, s)));
    }
    body->kinetic_energy = 0.5 * T;
    body->potential_energy = V;
}
