/* FMI 2.0 face: every function of the standard, co-simulation. Value reference = place in Plant.v.
 */
#include "model.h"

#ifdef FMI2_FUNCTION_PREFIX
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

/* The standard fixes the signatures: a parameter without use is no mistake. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

typedef unsigned int Ref;
#define STANDARD(name) fmi2##name
#define TYPE_OF(ref) ((ref) >= N_VALUES ? -1 : (ref) == V_leg_spin ? ENUMERATION : FLOAT64)
#define OFFSET(ref) ((int)(ref))
#define COUNT(ref) ((void)(ref), 1)
#define VALUES(T) T values[]
#define N_GIVEN n
#include "access.h"

typedef const char *String;
typedef void (*Logger)(void *environment, String name, int status, String category, String message, ...);

typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

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

ACCESS(GetReal, SetReal, double, FLOAT64)
ACCESS(GetInteger, SetInteger, int, ENUMERATION)

/* There are no derivatives of inputs and outputs. */
NO_VARIABLES(SetRealInputDerivatives)
NO_VARIABLES(GetRealOutputDerivatives)

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

API FMI(fmi2DoStep)(void *c, double time, double dt, int no_set_state_before)
{
    return instance_step(c, time, dt);
}
UNSUPPORTED(CancelStep)

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
UNSUPPORTED(GetIntegerStatus)
API FMI(fmi2GetBooleanStatus)(void *c, int kind, int *value)
{
    if (!c || kind != 3) return instance_unsupported(c, "fmi2GetBooleanStatus");
    *value = 0;
    return OK;
}
UNSUPPORTED(GetStringStatus)

/* Model exchange. */
UNSUPPORTED(NewDiscreteStates)
UNSUPPORTED(GetDerivatives)
