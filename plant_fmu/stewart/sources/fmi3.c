/* FMI 3.0 face: every function of the standard, co-simulation. Value reference = row of VARIABLES.
 */
#include <stdbool.h>
#include <stdint.h>

#include "model.h"

#ifdef FMI3_FUNCTION_PREFIX
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

/* The standard fixes the signatures: a parameter without use is no mistake. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

typedef uint32_t Ref;
#define STANDARD(name) fmi3##name
#define TYPE_OF(ref) ((ref) >= N_VARIABLES ? -1 : VARIABLES[ref].type)
#define OFFSET(ref) VARIABLES[ref].offset
#define COUNT(ref) VARIABLES[ref].count
#define VALUES(T) T values[], size_t n_values
#define N_GIVEN n_values
#include "access.h"

typedef const char *String;
typedef void (*Logger)(void *environment, int status, String category, String message);
typedef void (*Callback)(void);

static void report(const Instance *instance, Status status, const char *message)
{
    const Logger logger = (Logger)instance->logger;
    if (logger) logger(instance->environment, status, "logStatusError", message);
}

EXPORT String FMI(fmi3GetVersion)(void) { return "3.0"; }

API FMI(fmi3SetDebugLogging)(void *c, bool on, size_t n, const String categories[])
{
    return instance_set_logging(c, on, n, categories);
}

EXPORT void *FMI(fmi3InstantiateCoSimulation)(String name, String token, String resources, bool visible, bool logging,
                                              bool event_mode, bool early_return, const Ref intermediate[],
                                              size_t n_intermediate, void *environment, Logger logger,
                                              Callback intermediate_update)
{
    Instance *instance = instance_new(name, token, logging, report, environment, (Function)logger);
    if (instance && n_intermediate > 0) {
        instance_unsupported(instance, "intermediate update");
        instance_free(instance);
        return NULL;
    }
    return instance;
}

EXPORT void *FMI(fmi3InstantiateModelExchange)(String name, String token, String resources, bool visible, bool logging,
                                               void *environment, Logger logger)
{
    if (logger) logger(environment, ERROR, "logStatusError", "model exchange is not supported by this FMU");
    return NULL;
}

EXPORT void *FMI(fmi3InstantiateScheduledExecution)(String name, String token, String resources, bool visible,
                                                    bool logging, void *environment, Logger logger, Callback update,
                                                    Callback lock, Callback unlock)
{
    if (logger) logger(environment, ERROR, "logStatusError", "scheduled execution is not supported by this FMU");
    return NULL;
}

API FMI(fmi3EnterInitializationMode)(void *c, bool tolerance_defined, double tolerance, double start,
                                     bool stop_defined, double stop)
{
    return instance_enter_initialisation(c, start);
}

ACCESS(GetFloat64, SetFloat64, double, FLOAT64)
ACCESS(GetInt64, SetInt64, int64_t, ENUMERATION)

/* There are no variables of these types. */
WITHOUT(Float32)
WITHOUT(Int8)
WITHOUT(UInt8)
WITHOUT(Int16)
WITHOUT(UInt16)
WITHOUT(Int32)
WITHOUT(UInt32)
WITHOUT(UInt64)

/* The rest of the standard that this FMU has no use for. */
UNSUPPORTED(GetBinary)
UNSUPPORTED(SetBinary)
UNSUPPORTED(GetClock)
UNSUPPORTED(SetClock)
UNSUPPORTED(GetNumberOfVariableDependencies)
UNSUPPORTED(GetVariableDependencies)
UNSUPPORTED(GetAdjointDerivative)
UNSUPPORTED(GetIntervalDecimal)
UNSUPPORTED(GetIntervalFraction)
UNSUPPORTED(GetShiftDecimal)
UNSUPPORTED(GetShiftFraction)
UNSUPPORTED(SetIntervalDecimal)
UNSUPPORTED(SetIntervalFraction)
UNSUPPORTED(SetShiftDecimal)
UNSUPPORTED(SetShiftFraction)
UNSUPPORTED(UpdateDiscreteStates)
UNSUPPORTED(GetContinuousStateDerivatives)
UNSUPPORTED(GetNumberOfEventIndicators)
UNSUPPORTED(GetNumberOfContinuousStates)
UNSUPPORTED(GetOutputDerivatives)
UNSUPPORTED(ActivateModelPartition)
UNSUPPORTED(EnterConfigurationMode)
UNSUPPORTED(ExitConfigurationMode)
UNSUPPORTED(EvaluateDiscreteStates)
UNSUPPORTED(EnterStepMode)

API FMI(fmi3GetFMUState)(void *c, void **state) { return instance_save(c, state); }
API FMI(fmi3SetFMUState)(void *c, void *state) { return instance_restore(c, state); }
API FMI(fmi3FreeFMUState)(void *c, void **state) { return c ? instance_discard(state) : ERROR; }
API FMI(fmi3SerializedFMUStateSize)(void *c, void *state, size_t *size) { return instance_saved_size(c, state, size); }
API FMI(fmi3SerializeFMUState)(void *c, void *state, uint8_t bytes[], size_t size)
{
    return instance_serialise(c, state, bytes, size);
}
API FMI(fmi3DeserializeFMUState)(void *c, const uint8_t bytes[], size_t size, void **state)
{
    return instance_deserialise(c, bytes, size, state);
}

API FMI(fmi3DoStep)(void *c, double time, double dt, bool no_set_state_before, bool *event_needed, bool *terminate,
                    bool *early_return, double *last_time)
{
    Instance *instance = c;
    const Status status = instance_step(instance, time, dt);
    *event_needed = *terminate = *early_return = false;
    if (instance) {
        const Plant *plant = &instance->plant;
        *last_time = plant->start_time + (double)plant->steps * plant->v[V_internal_step];
    }
    return status;
}
