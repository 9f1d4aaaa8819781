/* Brakes, dry friction and end stops as one small quadratic programme. See contact.h for the laws.
 *
 * With w = c + h A f the rates at the end of the step (A = J M^-1 J^T, c the rates without f), stick-slip is
 *   minimise f.(h A f)/2 + c.f  subject to |f| <= friction,
 * and a stop adds a row with the compliance 1/(h k + d) and one open bound. The matrix is symmetric and positive
 * definite, so the solution is unique: nothing has to be remembered from the step before.
 */
#include "contact.h"

#include <math.h>

#define ROWS (2 * LEGS)

enum { FREE, AT_LOW, AT_HIGH };

typedef struct {
    int n, leg[ROWS];
    double H[ROWS][ROWS], c[ROWS], low[ROWS], high[ROWS], f[ROWS];
} Programme;

/* Solve the rows that are free, the others fixed at their bounds. */
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

/* Change the state of every row that breaks its law, or only of the first one. Returns how many broke it. */
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
        if (next != state[i]) {
            state[i] = next;
            broken++;
            if (first_only) return broken;
        }
    }
    return broken;
}

static void add_row(Programme *q, int leg, double c, double compliance, double low, double high)
{
    const int i = q->n++;
    q->leg[i] = leg, q->c[i] = c, q->low[i] = low, q->high[i] = high, q->H[i][i] = compliance;
}

int contact_forces(const Stops *stops, const Equations *e, const double friction[LEGS], const double free[6], double h,
                   double tau[LEGS], double dtwist[6])
{
    Programme q;
    double Y[LEGS][6];
    int state[ROWS], have[LEGS] = {0};
    const double stiff = h * stops->stop_stiffness + stops->stop_damping;
    q.n = 0;
    for (int i = 0; i < LEGS; i++) {
        double rate = e->dl[i] + h * e->bias[i];
        for (int k = 0; k < 6; k++) rate += h * e->J[i][k] * free[k];
        if (friction[i] > 0.0) add_row(&q, i, rate, 0.0, -friction[i], friction[i]);
        const double under = e->l[i] - stops->length_min[i], over = e->l[i] - stops->length_max[i];
        const double reach = h * (fabs(rate) + fabs(e->dl[i]));
        if (under < reach) add_row(&q, i, rate + stops->stop_stiffness * under / stiff, 1.0 / stiff, 0.0, HUGE_VAL);
        if (over > -reach) add_row(&q, i, rate + stops->stop_stiffness * over / stiff, 1.0 / stiff, -HUGE_VAL, 0.0);
    }
    if (q.n == 0) return 0;
    for (int i = 0; i < q.n; i++) {
        const int leg = q.leg[i];
        if (!have[leg]) {
            solve_mass(e, e->J[leg], Y[leg]);
            have[leg] = 1;
        }
        const double compliance = q.H[i][i];
        for (int k = 0; k <= i; k++) {
            double A = 0.0;
            for (int r = 0; r < 6; r++) A += e->J[q.leg[k]][r] * Y[leg][r];
            q.H[i][k] = q.H[k][i] = h * A;
        }
        /* The last term keeps the matrix regular at a singular pose: a creep of 1e-12 of the free rate. */
        q.H[i][i] = q.H[i][i] * (1.0 + 1e-12) + compliance;
    }
    /* Block pivoting ends in two or three rounds; least-index pivoting, which always ends, is the reserve.
     * A stop starts open. */
    for (int i = 0; i < q.n; i++) state[i] = q.low[i] == 0.0 ? AT_LOW : q.high[i] == 0.0 ? AT_HIGH : FREE;
    for (int round = 0; round < 200; round++) {
        if (solve_free(&q, state) != 0) break;
        if (pivot(&q, state, round > 12) == 0) break;
    }
    for (int i = 0; i < q.n; i++) {
        double f = q.f[i];
        if (f < q.low[i]) f = q.low[i];
        if (f > q.high[i]) f = q.high[i];
        tau[q.leg[i]] += f;
        for (int k = 0; k < 6; k++) dtwist[k] += Y[q.leg[i]][k] * f;
    }
    return q.n;
}
