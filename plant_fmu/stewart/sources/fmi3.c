/* FMI 3.0 interface: every function of the standard, co-simulation. Value reference = row of VARIABLES. */
#include <stdbool.h>
#include <stdint.h>

#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX
#endif
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#define STANDARD(name) JOIN(fmi3, name)
#define STATE(before, after) before##FMUState##after
#define DESERIALISE DeserializeFMUState

typedef const char *String;
typedef void (*Logger)(void *environment, int status, String category, String message);
typedef void (*Callback)(void);
#define LOG(i, message) (i)->logger((i)->environment, ERROR, "logStatusError", message)

typedef uint32_t Ref;
#define TYPE_OF(ref) ((ref) >= N_VARIABLES ? -1 : VARIABLES[ref].type)
#define OFFSET(ref) VARIABLES[ref].offset
#define COUNT(ref) VARIABLES[ref].count
#define VALUES(T) T values[], size_t n_values
#define N_GIVEN n_values
#include "face.h"

EXPORT String FMI(fmi3GetVersion)(void) { return "3.0"; }

EXPORT void *FMI(fmi3InstantiateCoSimulation)(String name, String token, String resources, bool visible, bool logging,
                                              bool event_mode, bool early_return, const Ref intermediate[],
                                              size_t n_intermediate, void *environment, Logger logger,
                                              Callback intermediate_update)
{
    return instance_new(name, token, environment, logger, n_intermediate > 0 ? "intermediate update" : NULL);
}

/* The model description offers co-simulation only. */
EXPORT void *FMI(fmi3InstantiateModelExchange)(void) { return NULL; }
EXPORT void *FMI(fmi3InstantiateScheduledExecution)(void) { return NULL; }

API FMI(fmi3EnterInitializationMode)(Instance *instance, bool tolerance_defined, double tolerance, double start,
                                     bool stop_defined, double stop)
{
    return instance_enter_initialisation(instance, start);
}

ACCESS(GetFloat64, SetFloat64, double, FLOAT64)
ACCESS(GetInt64, SetInt64, int64_t, INTEGER)

API FMI(fmi3DoStep)(Instance *instance, double time, double dt, bool no_set_state_before, bool *event_needed,
                    bool *terminate, bool *early_return, double *last_time)
{
    const Status status = instance_step(instance, time, dt);
    *event_needed = *terminate = *early_return = false;
#ifdef LS_BUS
    if (instance) *event_needed = instance->plant.drives.size > 0;
#endif
    if (instance) *last_time = instance->plant.v.time;
    return status;
}

/* There are no variables of these types. */
WITHOUT(Float32)
WITHOUT(Int8)
WITHOUT(UInt8)
WITHOUT(Int16)
WITHOUT(UInt16)
WITHOUT(Int32)
WITHOUT(UInt32)
WITHOUT(UInt64)

/* Other functions of the standard that this FMU does not support. */
UNSUPPORTED(SetIntervalDecimal)
BOTH_UNSUPPORTED(IntervalFraction)
BOTH_UNSUPPORTED(ShiftDecimal)
BOTH_UNSUPPORTED(ShiftFraction)
UNSUPPORTED(GetNumberOfVariableDependencies)
UNSUPPORTED(GetVariableDependencies)
UNSUPPORTED(GetAdjointDerivative)
UNSUPPORTED(GetContinuousStateDerivatives)
UNSUPPORTED(GetNumberOfEventIndicators)
UNSUPPORTED(GetNumberOfContinuousStates)
UNSUPPORTED(GetOutputDerivatives)
UNSUPPORTED(ActivateModelPartition)
UNSUPPORTED(EnterConfigurationMode)
UNSUPPORTED(ExitConfigurationMode)
UNSUPPORTED(EvaluateDiscreteStates)

#ifdef LS_BUS
#include "terminal.h"
#else
BOTH_UNSUPPORTED(Binary)
BOTH_UNSUPPORTED(Clock)
UNSUPPORTED(GetIntervalDecimal)
UNSUPPORTED(UpdateDiscreteStates)
UNSUPPORTED(EnterEventMode)
UNSUPPORTED(EnterStepMode)
#endif
