/* Brakes, dry friction and end stops as one small quadratic programme.
 *
 * The forces solve, for the leg rates dl + h (J^T dtwist + bias) at the end of the step,
 *   stick     rate = 0          while |force| < friction, of brake and dry friction together,
 *   slip      force = -friction sign(rate) otherwise,
 *   stops     force = -k (overrun at the end of the step) - d rate, never pulling.
 * All coupled through A = J^T M^-1 J, so that the step is stable for any stiffness.
 *
 * With w = c + h A f the rates at the end of the step (c the rates without f), stick-slip is
 *   minimise f.(h A f)/2 + c.f  subject to |f| <= friction,
 * and a stop adds a row with the compliance 1/(h k + d) and one open bound. The matrix is symmetric and positive
 * definite, so the solution is unique: no state is needed from the previous step.
 */
#include "plant.h"

#include <math.h>

#define ROWS (3 * LEGS) /* per leg: friction and both stops, if it crosses its whole stroke in one step */

enum { FREE, AT_LOW, AT_HIGH };

typedef struct {
    int n, leg[ROWS];
    double c[ROWS], low[ROWS], high[ROWS], f[ROWS], H[ROWS][ROWS];
} Programme;

/* Solve for the free rows; the others are fixed at their bounds. */
static int solve_free(Programme *q, const int state[ROWS])
{
    int index[ROWS], n = 0;
    double L[ROWS][ROWS], y[ROWS], d[ROWS];
    for (int i = 0; i < q->n; i++) {
        if (state[i] == FREE) index[n++] = i;
        else q->f[i] = state[i] == AT_LOW ? q->low[i] : q->high[i];
    }
    for (int i = 0; i < n; i++) {
        double r = -q->c[index[i]];
        for (int k = 0; k < q->n; k++)
            if (state[k] != FREE) r -= q->H[index[i]][k] * q->f[k];
        y[i] = r;
        for (int j = 0; j <= i; j++) {
            double sum = q->H[index[i]][index[j]];
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k] * d[k];
            if (j < i) L[i][j] = sum / d[j];
            else d[i] = sum;
        }
        if (!(d[i] > 0.0)) return -1;
        for (int k = 0; k < i; k++) y[i] -= L[i][k] * y[k];
    }
    for (int i = 0; i < n; i++) y[i] /= d[i];
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) y[i] -= L[k][i] * y[k];
        q->f[index[i]] = y[i];
    }
    return 0;
}

/* Change the state of all rows that violate their law, or only of the first. Returns the number of violations. */
static int pivot(const Programme *q, int state[ROWS], int first_only)
{
    int broken = 0;
    for (int i = 0; i < q->n; i++) {
        int next = state[i];
        if (state[i] == FREE) {
            if (q->f[i] < q->low[i]) next = AT_LOW;
            else if (q->f[i] > q->high[i]) next = AT_HIGH;
        } else {
            double w = q->c[i];
            for (int k = 0; k < q->n; k++) w += q->H[i][k] * q->f[k];
            if (state[i] == AT_LOW ? w < 0.0 : w > 0.0) next = FREE;
        }
        if (next == state[i]) continue;
        state[i] = next;
        broken++;
        if (first_only) break;
    }
    return broken;
}

static void add_row(Programme *q, int leg, double c, double compliance, double low, double high)
{
    const int i = q->n++;
    q->leg[i] = leg, q->c[i] = c, q->low[i] = low, q->high[i] = high, q->H[i][i] = compliance;
}

void contact_forces(const Values *v, const Equations *e, double h, double tau[LEGS], double dtwist[6])
{
    Programme q;
    double Y[LEGS][6], rates[LEGS];
    int state[ROWS], have[LEGS] = {0};
    const double stiff = h * v->stop_stiffness + v->stop_damping;
    for (int i = 0; i < LEGS; i++) rates[i] = e->dl[i] + h * e->bias[i], tau[i] = 0.0;
    for (int k = 0; k < 6; k++)
        for (int i = 0; i < LEGS; i++) rates[i] += h * e->J[k][i] * dtwist[k];
    q.n = 0;
    for (int i = 0; i < LEGS; i++) {
        const double rate = rates[i], friction = v->coulomb_friction[i] + v->brake[i] * v->brake_force[i];
        if (friction > 0.0) add_row(&q, i, rate, 0.0, -friction, friction);
        const double under = e->l[i] - v->length_min[i], over = e->l[i] - v->length_max[i];
        const double reach = h * (fabs(rate) + fabs(e->dl[i]));
        if (under < reach) add_row(&q, i, rate + v->stop_stiffness * under / stiff, 1.0 / stiff, 0.0, HUGE_VAL);
        if (over > -reach) add_row(&q, i, rate + v->stop_stiffness * over / stiff, 1.0 / stiff, -HUGE_VAL, 0.0);
    }
    for (int i = 0; i < q.n; i++) {
        const int leg = q.leg[i];
        if (!have[leg]) {
            for (int r = 0; r < 6; r++) Y[leg][r] = e->J[r][leg];
            solve_mass(e, Y[leg]);
            have[leg] = 1;
        }
        const double compliance = q.H[i][i];
        for (int k = 0; k <= i; k++) {
            double A = 0.0;
            for (int r = 0; r < 6; r++) A += e->J[r][q.leg[k]] * Y[leg][r];
            q.H[i][k] = q.H[k][i] = h * A;
        }
        /* The last term keeps the matrix regular at a singular pose; it causes a creep of 1e-12 of the free rate. */
        q.H[i][i] = q.H[i][i] * (1.0 + 1e-12) + compliance;
    }
    /* Block pivoting ends in two or three rounds; least-index pivoting, which always ends, is the fallback.
     * A stop starts open. */
    for (int i = 0; i < q.n; i++) state[i] = q.low[i] == 0.0 ? AT_LOW : q.high[i] == 0.0 ? AT_HIGH : FREE;
    for (int round = 0; round < 200; round++)
        if (solve_free(&q, state) != 0 || pivot(&q, state, round > 12) == 0) break;
    for (int i = 0; i < q.n; i++) {
        const double f = q.f[i] < q.low[i] ? q.low[i] : q.f[i] > q.high[i] ? q.high[i] : q.f[i];
        tau[q.leg[i]] += f;
        for (int k = 0; k < 6; k++) dtwist[k] += Y[q.leg[i]][k] * f;
    }
}
