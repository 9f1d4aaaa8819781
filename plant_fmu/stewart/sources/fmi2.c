/* FMI 2.0 face: every function of the standard, co-simulation. Value reference = place in Plant.v.
 */
#include "instance.h"

#ifdef FMI2_FUNCTION_PREFIX
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

/* The standard fixes the signatures: a parameter without use is no mistake. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

typedef unsigned int Ref;
typedef const char *String;
typedef void (*Logger)(void *environment, String name, int status, String category, String message, ...);

typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

typedef struct {
    int new_discrete_states, terminate, nominals_changed, values_changed, next_time_defined;
    double next_time;
} EventInfo;

static void report(const Instance *instance, Status status, const char *message)
{
    const Logger logger = (Logger)instance->logger;
    if (logger) logger(instance->environment, instance->name, status, "logStatusError", "%s", message);
}

EXPORT String FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT String FMI(fmi2GetVersion)(void) { return "2.0"; }

API FMI(fmi2SetDebugLogging)(void *c, int on, size_t n, const String categories[])
{
    return instance_set_logging(c, on, n, categories);
}

EXPORT void *FMI(fmi2Instantiate)(String name, int type, String guid, String resources, const Callbacks *callbacks,
                                  int visible, int logging)
{
    Instance *instance = instance_new(name, guid, logging, report, callbacks ? callbacks->environment : NULL,
                                      callbacks ? (Function)callbacks->logger : NULL);
    if (instance && type != 1) {
        instance_unsupported(instance, "model exchange");
        instance_free(instance);
        return NULL;
    }
    return instance;
}

EXPORT void FMI(fmi2FreeInstance)(void *c) { instance_free(c); }

API FMI(fmi2SetupExperiment)(void *c, int tolerance_defined, double tolerance, double start, int stop_defined,
                             double stop)
{
    Instance *instance = c;
    if (!instance) return ERROR;
    if (instance->plant.mode != INSTANTIATED) return instance_fail(instance, "the experiment is set up already");
    if (!(start == start && start - start == 0.0)) return instance_fail(instance, "the start time is not finite");
    instance->plant.start_time = start;
    return OK;
}

API FMI(fmi2EnterInitializationMode)(void *c)
{
    return c ? instance_enter_initialisation(c, ((Instance *)c)->plant.start_time) : ERROR;
}
API FMI(fmi2ExitInitializationMode)(void *c) { return instance_exit_initialisation(c); }
API FMI(fmi2Terminate)(void *c) { return instance_terminate(c); }
API FMI(fmi2Reset)(void *c) { return instance_reset(c); }

static int type_at(Ref ref) { return ref == V_leg_spin ? ENUMERATION : FLOAT64; }

static int known(const Instance *instance, const Ref vr[], size_t n, int type)
{
    for (size_t i = 0; i < n; i++)
        if (vr[i] >= N_VALUES || type_at(vr[i]) != type) {
            instance_fail(instance, "unknown value reference for this type");
            return 0;
        }
    return 1;
}

API FMI(fmi2GetReal)(void *c, const Ref vr[], size_t n, double value[])
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || !known(instance, vr, n, FLOAT64)) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (plant_refresh(&instance->plant, (int)vr[i], why) != 0) return instance_fail(instance, why);
        value[i] = instance->plant.v[vr[i]];
    }
    return OK;
}

API FMI(fmi2GetInteger)(void *c, const Ref vr[], size_t n, int value[])
{
    Instance *instance = c;
    if (!instance || !known(instance, vr, n, ENUMERATION)) return ERROR;
    for (size_t i = 0; i < n; i++) value[i] = (int)instance->plant.v[vr[i]];
    return OK;
}

API FMI(fmi2SetReal)(void *c, const Ref vr[], size_t n, const double value[])
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || !known(instance, vr, n, FLOAT64)) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (plant_check(&instance->plant, (int)vr[i], value[i], why) != 0) return instance_fail(instance, why);
    for (size_t i = 0; i < n; i++) plant_store(&instance->plant, (int)vr[i], value[i]);
    return OK;
}

API FMI(fmi2SetInteger)(void *c, const Ref vr[], size_t n, const int value[])
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || !known(instance, vr, n, ENUMERATION)) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (plant_check(&instance->plant, (int)vr[i], value[i], why) != 0) return instance_fail(instance, why);
    for (size_t i = 0; i < n; i++) plant_store(&instance->plant, (int)vr[i], value[i]);
    return OK;
}

/* There are no Boolean and no String variables, and no derivatives of inputs and outputs. */
NO_VARIABLES(fmi2GetBoolean, void *c, const Ref vr[], size_t n, int value[])
NO_VARIABLES(fmi2GetString, void *c, const Ref vr[], size_t n, String value[])
NO_VARIABLES(fmi2SetBoolean, void *c, const Ref vr[], size_t n, const int value[])
NO_VARIABLES(fmi2SetString, void *c, const Ref vr[], size_t n, const String value[])
NO_VARIABLES(fmi2SetRealInputDerivatives, void *c, const Ref vr[], size_t n, const int order[], const double value[])
NO_VARIABLES(fmi2GetRealOutputDerivatives, void *c, const Ref vr[], size_t n, const int order[], double value[])

API FMI(fmi2GetFMUstate)(void *c, void **state) { return instance_save(c, state); }
API FMI(fmi2SetFMUstate)(void *c, void *state) { return instance_restore(c, state); }
API FMI(fmi2FreeFMUstate)(void *c, void **state) { return c ? instance_discard(state) : ERROR; }
API FMI(fmi2SerializedFMUstateSize)(void *c, void *state, size_t *size) { return instance_saved_size(c, state, size); }
API FMI(fmi2SerializeFMUstate)(void *c, void *state, char bytes[], size_t size)
{
    return instance_serialise(c, state, (unsigned char *)bytes, size);
}
API FMI(fmi2DeSerializeFMUstate)(void *c, const char bytes[], size_t size, void **state)
{
    return instance_deserialise(c, (const unsigned char *)bytes, size, state);
}
UNSUPPORTED(fmi2GetDirectionalDerivative, void *c, const Ref unknown[], size_t n_unknown, const Ref known_[],
            size_t n_known, const double dv_known[], double dv_unknown[])

API FMI(fmi2DoStep)(void *c, double time, double dt, int no_set_state_before)
{
    return instance_step(c, time, dt);
}
UNSUPPORTED(fmi2CancelStep, void *c)

/* No step is ever pending; status and last time are known after every step all the same. */
API FMI(fmi2GetStatus)(void *c, int kind, int *value)
{
    if (!c || kind != 0) return instance_unsupported(c, "fmi2GetStatus");
    *value = OK;
    return OK;
}
API FMI(fmi2GetRealStatus)(void *c, int kind, double *value)
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || kind != 2 || plant_refresh(&instance->plant, V_time, why) != 0)
        return instance_unsupported(c, "fmi2GetRealStatus");
    *value = instance->plant.v[V_time];
    return OK;
}
UNSUPPORTED(fmi2GetIntegerStatus, void *c, int kind, int *value)
API FMI(fmi2GetBooleanStatus)(void *c, int kind, int *value)
{
    if (!c || kind != 3) return instance_unsupported(c, "fmi2GetBooleanStatus");
    *value = 0;
    return OK;
}
UNSUPPORTED(fmi2GetStringStatus, void *c, int kind, String *value)

/* Model exchange. */
UNSUPPORTED(fmi2EnterEventMode, void *c)
UNSUPPORTED(fmi2NewDiscreteStates, void *c, EventInfo *info)
UNSUPPORTED(fmi2EnterContinuousTimeMode, void *c)
UNSUPPORTED(fmi2CompletedIntegratorStep, void *c, int no_set_state_before, int *enter_event_mode, int *terminate)
UNSUPPORTED(fmi2SetTime, void *c, double time)
UNSUPPORTED(fmi2SetContinuousStates, void *c, const double x[], size_t n)
UNSUPPORTED(fmi2GetDerivatives, void *c, double x[], size_t n)
UNSUPPORTED(fmi2GetEventIndicators, void *c, double x[], size_t n)
UNSUPPORTED(fmi2GetContinuousStates, void *c, double x[], size_t n)
UNSUPPORTED(fmi2GetNominalsOfContinuousStates, void *c, double x[], size_t n)
