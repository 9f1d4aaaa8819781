/* FMI 2.0 interface: every function of the standard, co-simulation. Value reference = place in Plant.v. */
#ifndef FMI2_FUNCTION_PREFIX
#define FMI2_FUNCTION_PREFIX
#endif
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
#define STANDARD(name) JOIN(fmi2, name)
#define STATE(before, after) before##FMUstate##after
#define DESERIALISE DeSerializeFMUstate

typedef const char *String;
typedef void (*Logger)(void *environment, String name, int status, String category, String message, ...);
#define LOG(i, message) (i)->logger((i)->environment, (i)->name, ERROR, "logStatusError", "%s", message)

typedef unsigned int Ref;
#define TYPE_OF(ref) ((ref) >= N_VALUES ? -1 : VARIABLES[OWNER[ref]].type)
#define OFFSET(ref) ((int)(ref))
#define COUNT(ref) ((void)(ref), 1)
#define VALUES(T) T values[]
#define N_GIVEN n
#include "face.h"

typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

EXPORT String FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT String FMI(fmi2GetVersion)(void) { return "2.0"; }

EXPORT void *FMI(fmi2Instantiate)(String name, int type, String guid, String resources, const Callbacks *callbacks,
                                  int visible, int logging)
{
    return instance_new(name, guid, callbacks ? callbacks->environment : NULL, callbacks ? callbacks->logger : NULL,
                        type == 1 ? NULL : "model exchange");
}

API FMI(fmi2SetupExperiment)(Instance *instance, int tolerance_defined, double tolerance, double start,
                             int stop_defined, double stop)
{
    if (!instance || instance->plant.mode != INSTANTIATED)
        return instance_fail(instance, "the experiment is already set up");
    if (!isfinite(start)) return instance_fail(instance, "the start time is not finite");
    instance->plant.start_time = instance->plant.v.time = start;
    return OK;
}

API FMI(fmi2EnterInitializationMode)(Instance *instance)
{
    return instance_enter_initialisation(instance, instance ? instance->plant.start_time : 0.0);
}

ACCESS(GetReal, SetReal, double, FLOAT64)
ACCESS(GetInteger, SetInteger, int, INTEGER)

/* There are no derivatives of inputs and outputs. */
NO_VARIABLES(SetRealInputDerivatives)
NO_VARIABLES(GetRealOutputDerivatives)

API FMI(fmi2DoStep)(Instance *instance, double time, double dt, int no_set_state_before)
{
    return instance_step(instance, time, dt);
}

/* No step is ever pending. */
UNSUPPORTED(GetStatus)
UNSUPPORTED(GetRealStatus)
UNSUPPORTED(GetBooleanStatus)
UNSUPPORTED(GetIntegerStatus)
UNSUPPORTED(GetStringStatus)
UNSUPPORTED(CancelStep)

/* Model exchange. */
UNSUPPORTED(EnterEventMode)
UNSUPPORTED(NewDiscreteStates)
UNSUPPORTED(GetDerivatives)
