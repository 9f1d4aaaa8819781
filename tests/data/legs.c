/* Six uncoupled legs with brakes as an FMI 2.0 co-simulation FMU, m dv/dt = f, with quirks by macro. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>

typedef void *Any;
typedef const char *Text;
typedef struct {
    void (*log)(Any, Text, int, Text, Text, ...);
    Any (*allocate)(size_t, size_t);
    void (*release)(Any);
    void (*finished)(Any, int);
    Any environment;
} Callbacks;
typedef struct {
    double f[6], b[6], q[6], v[6], t;
    int initialised;
    const Callbacks *callbacks;
} Legs;
#define API __attribute__((visibility("default")))
#define MASS 200.0
#define START 0.326
#ifdef STROKE
#define SHOWN(q) ((q) - START)
#else
#define SHOWN(q) (q)
#endif

API Text fmi2GetTypesPlatform(void) { return "default"; }
API Text fmi2GetVersion(void) { return "2.0"; }
API int fmi2SetDebugLogging(Any c, int on, size_t n, const Text *s) { return 0; }
API Any fmi2Instantiate(Text name, int kind, Text guid, Text folder, const Callbacks *callbacks, int show, int log)
{
#ifdef ONCE
    if (getenv("LEGS_ARE_THERE")) return NULL;
    setenv("LEGS_ARE_THERE", "1", 1);
#endif
    Legs *legs = calloc(1, sizeof *legs);
    legs->callbacks = callbacks;
    return legs;
}
API void fmi2FreeInstance(Any c) { free(c); }
API int fmi2SetupExperiment(Any c, int has, double tolerance, double t, int stops, double stop) { return 0; }
API int fmi2EnterInitializationMode(Any c)
{
    Legs *legs = c;
    legs->initialised++;
#ifdef INIT_ONCE
    return legs->initialised > 1 ? 3 : 0;
#endif
    return 0;
}
API int fmi2ExitInitializationMode(Any c)
{
    Legs *legs = c;
#ifdef RESET_KEEPS
    if (legs->initialised > 1) return 0;
#endif
    for (int i = 0; i < 6; i++) legs->q[i] = START, legs->v[i] = 0.0;
    legs->t = 0.0;
    return 0;
}
API int fmi2Terminate(Any c) { return 0; }
API int fmi2Reset(Any c)
{
#ifdef NO_RESET
    return 3;
#endif
#ifdef CRASHING_RESET
    abort();
#endif
    return 0;
}

static double *at(Legs *legs, unsigned r)
{
    return r < 6 ? &legs->f[r] : r < 12 ? &legs->b[r - 6] : r < 18 ? &legs->q[r - 12] : &legs->v[r - 18];
}
API int fmi2GetReal(Any c, const unsigned *r, size_t n, double *y)
{
    for (size_t i = 0; i < n; i++) y[i] = r[i] >= 12 && r[i] < 18 ? SHOWN(*at(c, r[i])) : *at(c, r[i]);
    return 0;
}
#define SET(name, type)                                                                                                \
    API int fmi2Set##name(Any c, const unsigned *r, size_t n, const type *u)                                           \
    {                                                                                                                  \
        for (size_t i = 0; i < n; i++) *at(c, r[i]) = u[i];                                                            \
        return 0;                                                                                                      \
    }
SET(Real, double)
SET(Integer, int)
SET(Boolean, int)

API int fmi2DoStep(Any c, double t, double h, int no_state)
{
    Legs *legs = c;
#ifdef FIXED
    if (fabs(h - FIXED) > 1e-12) return 3;
#endif
    legs->t = t + h;
#ifdef INNER /* whole steps of its own only; in between it holds its outputs */
    h = (floor(legs->t / INNER + 1e-9) - floor(t / INNER + 1e-9)) * INNER;
#endif
    for (int i = 0; i < 6; i++) {
        legs->v[i] = legs->b[i] > 0.5 ? 0.0 : legs->v[i] + legs->f[i] / MASS * h;
        legs->q[i] += legs->v[i] * h;
    }
#ifdef WARNS
    legs->callbacks->log(legs->callbacks->environment, "legs", 1, "logWarn", "tolerance %g not met at %g s", 1e-6, t);
    return 1;
#endif
    return 0;
}

/* What nobody calls, and a host may look for. */
#define ABSENT(name) API int fmi2##name(Any c) { return 3; }
ABSENT(GetInteger) ABSENT(GetBoolean) ABSENT(GetString) ABSENT(SetString) ABSENT(GetFMUstate) ABSENT(SetFMUstate)
ABSENT(FreeFMUstate) ABSENT(SerializedFMUstateSize) ABSENT(SerializeFMUstate) ABSENT(DeSerializeFMUstate)
ABSENT(GetDirectionalDerivative) ABSENT(SetRealInputDerivatives) ABSENT(GetRealOutputDerivatives) ABSENT(CancelStep)
ABSENT(GetStatus) ABSENT(GetRealStatus) ABSENT(GetIntegerStatus) ABSENT(GetBooleanStatus) ABSENT(GetStringStatus)
