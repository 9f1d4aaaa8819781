/* FMI 3.0 face: every function of the standard, co-simulation. Value reference = row of VARIABLES.
 */
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "instance.h"

#ifdef FMI3_FUNCTION_PREFIX
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

/* The standard fixes the signatures: a parameter without use is no mistake. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

typedef uint32_t Ref;
typedef const char *String;
typedef const uint8_t *Binary;
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

EXPORT void FMI(fmi3FreeInstance)(void *c) { instance_free(c); }

API FMI(fmi3EnterInitializationMode)(void *c, bool tolerance_defined, double tolerance, double start,
                                     bool stop_defined, double stop)
{
    return instance_enter_initialisation(c, start);
}
API FMI(fmi3ExitInitializationMode)(void *c) { return instance_exit_initialisation(c); }
UNSUPPORTED(fmi3EnterEventMode, void *c)
API FMI(fmi3Terminate)(void *c) { return instance_terminate(c); }
API FMI(fmi3Reset)(void *c) { return instance_reset(c); }

/* All references known, of this type, and together as long as the list of values. */
static int fits(const Instance *instance, const Ref vr[], size_t n, size_t n_values, int type)
{
    size_t total = 0;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= N_VARIABLES || VARIABLES[vr[i]].type != type) {
            instance_fail(instance, "unknown value reference for this type");
            return 0;
        }
        total += (size_t)VARIABLES[vr[i]].count;
    }
    if (total != n_values) {
        instance_fail(instance, "the number of values is not that of the variables' elements");
        return 0;
    }
    return 1;
}

API FMI(fmi3GetFloat64)(void *c, const Ref vr[], size_t n, double values[], size_t n_values)
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || !fits(instance, vr, n, n_values, FLOAT64)) return ERROR;
    for (size_t i = 0; i < n; i++) {
        const Variable *variable = &VARIABLES[vr[i]];
        if (plant_refresh(&instance->plant, variable->offset, why) != 0) return instance_fail(instance, why);
        memcpy(values, instance->plant.v + variable->offset, (size_t)variable->count * sizeof *values);
        values += variable->count;
    }
    return OK;
}

API FMI(fmi3SetFloat64)(void *c, const Ref vr[], size_t n, const double values[], size_t n_values)
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || !fits(instance, vr, n, n_values, FLOAT64)) return ERROR;
    const double *value = values;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < VARIABLES[vr[i]].count; k++)
            if (plant_check(&instance->plant, VARIABLES[vr[i]].offset + k, *value++, why) != 0)
                return instance_fail(instance, why);
    value = values;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < VARIABLES[vr[i]].count; k++)
            plant_store(&instance->plant, VARIABLES[vr[i]].offset + k, *value++);
    return OK;
}

API FMI(fmi3GetInt64)(void *c, const Ref vr[], size_t n, int64_t values[], size_t n_values)
{
    Instance *instance = c;
    if (!instance || !fits(instance, vr, n, n_values, ENUMERATION)) return ERROR;
    for (size_t i = 0; i < n; i++) values[i] = (int64_t)instance->plant.v[VARIABLES[vr[i]].offset];
    return OK;
}

API FMI(fmi3SetInt64)(void *c, const Ref vr[], size_t n, const int64_t values[], size_t n_values)
{
    Instance *instance = c;
    char why[REASON_SIZE];
    if (!instance || !fits(instance, vr, n, n_values, ENUMERATION)) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (plant_check(&instance->plant, VARIABLES[vr[i]].offset, (double)values[i], why) != 0)
            return instance_fail(instance, why);
    for (size_t i = 0; i < n; i++) plant_store(&instance->plant, VARIABLES[vr[i]].offset, (double)values[i]);
    return OK;
}

NO_VARIABLES(fmi3GetFloat32, void *c, const Ref vr[], size_t n, float values[], size_t n_values)
NO_VARIABLES(fmi3GetInt8, void *c, const Ref vr[], size_t n, int8_t values[], size_t n_values)
NO_VARIABLES(fmi3GetUInt8, void *c, const Ref vr[], size_t n, uint8_t values[], size_t n_values)
NO_VARIABLES(fmi3GetInt16, void *c, const Ref vr[], size_t n, int16_t values[], size_t n_values)
NO_VARIABLES(fmi3GetUInt16, void *c, const Ref vr[], size_t n, uint16_t values[], size_t n_values)
NO_VARIABLES(fmi3GetInt32, void *c, const Ref vr[], size_t n, int32_t values[], size_t n_values)
NO_VARIABLES(fmi3GetUInt32, void *c, const Ref vr[], size_t n, uint32_t values[], size_t n_values)
NO_VARIABLES(fmi3GetUInt64, void *c, const Ref vr[], size_t n, uint64_t values[], size_t n_values)
NO_VARIABLES(fmi3GetBoolean, void *c, const Ref vr[], size_t n, bool values[], size_t n_values)
NO_VARIABLES(fmi3GetString, void *c, const Ref vr[], size_t n, String values[], size_t n_values)
NO_VARIABLES(fmi3SetFloat32, void *c, const Ref vr[], size_t n, const float values[], size_t n_values)
NO_VARIABLES(fmi3SetInt8, void *c, const Ref vr[], size_t n, const int8_t values[], size_t n_values)
NO_VARIABLES(fmi3SetUInt8, void *c, const Ref vr[], size_t n, const uint8_t values[], size_t n_values)
NO_VARIABLES(fmi3SetInt16, void *c, const Ref vr[], size_t n, const int16_t values[], size_t n_values)
NO_VARIABLES(fmi3SetUInt16, void *c, const Ref vr[], size_t n, const uint16_t values[], size_t n_values)
NO_VARIABLES(fmi3SetInt32, void *c, const Ref vr[], size_t n, const int32_t values[], size_t n_values)
NO_VARIABLES(fmi3SetUInt32, void *c, const Ref vr[], size_t n, const uint32_t values[], size_t n_values)
NO_VARIABLES(fmi3SetUInt64, void *c, const Ref vr[], size_t n, const uint64_t values[], size_t n_values)
NO_VARIABLES(fmi3SetBoolean, void *c, const Ref vr[], size_t n, const bool values[], size_t n_values)
NO_VARIABLES(fmi3SetString, void *c, const Ref vr[], size_t n, const String values[], size_t n_values)

/* The rest of the standard that this FMU has no use for. */
UNSUPPORTED(fmi3GetBinary, void *c, const Ref vr[], size_t n, size_t sizes[], Binary values[], size_t n_values)
UNSUPPORTED(fmi3SetBinary, void *c, const Ref vr[], size_t n, const size_t sizes[], const Binary values[],
            size_t n_values)
UNSUPPORTED(fmi3GetClock, void *c, const Ref vr[], size_t n, bool values[])
UNSUPPORTED(fmi3SetClock, void *c, const Ref vr[], size_t n, const bool values[])
UNSUPPORTED(fmi3GetNumberOfVariableDependencies, void *c, Ref vr, size_t *n)
UNSUPPORTED(fmi3GetVariableDependencies, void *c, Ref dependent, size_t elements[], Ref independents[],
            size_t independent_elements[], int kinds[], size_t n)
UNSUPPORTED(fmi3GetDirectionalDerivative, void *c, const Ref unknowns[], size_t n_unknowns, const Ref knowns[],
            size_t n_knowns, const double seed[], size_t n_seed, double sensitivity[], size_t n_sensitivity)
UNSUPPORTED(fmi3GetAdjointDerivative, void *c, const Ref unknowns[], size_t n_unknowns, const Ref knowns[],
            size_t n_knowns, const double seed[], size_t n_seed, double sensitivity[], size_t n_sensitivity)
UNSUPPORTED(fmi3GetIntervalDecimal, void *c, const Ref vr[], size_t n, double intervals[], int qualifiers[])
UNSUPPORTED(fmi3GetIntervalFraction, void *c, const Ref vr[], size_t n, uint64_t counters[], uint64_t resolutions[],
            int qualifiers[])
UNSUPPORTED(fmi3GetShiftDecimal, void *c, const Ref vr[], size_t n, double shifts[])
UNSUPPORTED(fmi3GetShiftFraction, void *c, const Ref vr[], size_t n, uint64_t counters[], uint64_t resolutions[])
UNSUPPORTED(fmi3SetIntervalDecimal, void *c, const Ref vr[], size_t n, const double intervals[])
UNSUPPORTED(fmi3SetIntervalFraction, void *c, const Ref vr[], size_t n, const uint64_t counters[],
            const uint64_t resolutions[])
UNSUPPORTED(fmi3SetShiftDecimal, void *c, const Ref vr[], size_t n, const double shifts[])
UNSUPPORTED(fmi3SetShiftFraction, void *c, const Ref vr[], size_t n, const uint64_t counters[],
            const uint64_t resolutions[])
UNSUPPORTED(fmi3UpdateDiscreteStates, void *c, bool *need_update, bool *terminate, bool *nominals, bool *values,
            bool *next, double *next_time)
UNSUPPORTED(fmi3CompletedIntegratorStep, void *c, bool no_set_state_before, bool *enter_event_mode, bool *terminate)
UNSUPPORTED(fmi3SetTime, void *c, double time)
UNSUPPORTED(fmi3SetContinuousStates, void *c, const double x[], size_t n)
UNSUPPORTED(fmi3GetContinuousStateDerivatives, void *c, double dx[], size_t n)
UNSUPPORTED(fmi3GetEventIndicators, void *c, double z[], size_t n)
UNSUPPORTED(fmi3GetContinuousStates, void *c, double x[], size_t n)
UNSUPPORTED(fmi3GetNominalsOfContinuousStates, void *c, double nominals[], size_t n)
UNSUPPORTED(fmi3GetNumberOfEventIndicators, void *c, size_t *n)
UNSUPPORTED(fmi3GetNumberOfContinuousStates, void *c, size_t *n)
UNSUPPORTED(fmi3GetOutputDerivatives, void *c, const Ref vr[], size_t n, const int32_t orders[], double values[],
            size_t n_values)
UNSUPPORTED(fmi3ActivateModelPartition, void *c, Ref clock, double time)
UNSUPPORTED(fmi3EnterConfigurationMode, void *c)
UNSUPPORTED(fmi3ExitConfigurationMode, void *c)
UNSUPPORTED(fmi3EvaluateDiscreteStates, void *c)
UNSUPPORTED(fmi3EnterContinuousTimeMode, void *c)
UNSUPPORTED(fmi3EnterStepMode, void *c)

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
