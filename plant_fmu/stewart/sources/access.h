/* What both FMI faces share: how values are got and set, and functions that this FMU has no use for.
 * A face defines before: Ref; STANDARD(name), as fmi2Name; FMI(name), with the importer's prefix; TYPE_OF(ref), -1
 * for an unknown one; OFFSET(ref) and COUNT(ref), the elements of a value reference in Plant.v; VALUES(T), the
 * parameters that hold them, and N_GIVEN of them. */
#ifndef STEWART_ACCESS_H
#define STEWART_ACCESS_H

#include "instance.h"

/* All references known, of this type, and together as long as the list of values. */
static Status fits(const Instance *instance, const Ref vr[], size_t n, size_t n_values, int type)
{
    size_t total = 0;
    for (size_t i = 0; i < n; i++) {
        if (TYPE_OF(vr[i]) != type) return instance_fail(instance, "unknown value reference for this type");
        total += (size_t)COUNT(vr[i]);
    }
    if (total == n_values) return OK;
    return instance_fail(instance, "the number of values is not that of the variables' elements");
}

#define ACCESS(get, set, T, TYPE)                                                                                  \
    API FMI(STANDARD(get))(void *c, const Ref vr[], size_t n, VALUES(T))                                           \
    {                                                                                                              \
        Instance *instance = c;                                                                                    \
        char why[REASON_SIZE];                                                                                     \
        if (!instance || fits(instance, vr, n, N_GIVEN, TYPE) != OK) return ERROR;                                 \
        for (size_t i = 0; i < n; i++) {                                                                           \
            if (plant_refresh(&instance->plant, OFFSET(vr[i]), why) != 0) return instance_fail(instance, why);     \
            for (int k = 0; k < COUNT(vr[i]); k++) *values++ = (T)instance->plant.v[OFFSET(vr[i]) + k];            \
        }                                                                                                          \
        return OK;                                                                                                 \
    }                                                                                                              \
    API FMI(STANDARD(set))(void *c, const Ref vr[], size_t n, VALUES(const T))                                     \
    {                                                                                                              \
        Instance *instance = c;                                                                                    \
        char why[REASON_SIZE];                                                                                     \
        if (!instance || fits(instance, vr, n, N_GIVEN, TYPE) != OK) return ERROR;                                 \
        const T *value = values;                                                                                   \
        for (size_t i = 0; i < n; i++)                                                                             \
            for (int k = 0; k < COUNT(vr[i]); k++)                                                                 \
                if (plant_check(&instance->plant, OFFSET(vr[i]) + k, (double)*value++, why) != 0)                  \
                    return instance_fail(instance, why);                                                           \
        for (size_t i = 0; i < n; i++)                                                                             \
            for (int k = 0; k < COUNT(vr[i]); k++)                                                                 \
                plant_store(&instance->plant, OFFSET(vr[i]) + k, (double)*values++);                               \
        return OK;                                                                                                 \
    }

/* Functions of the standard that this FMU has no use for, and those of a type without variables, where an empty
 * list is no error. They name the parameters that they look at: on all our targets the caller removes the rest. */
#define TEXT2(name) #name
#define TEXT(name) TEXT2(name)
#define UNSUPPORTED(function) \
    API FMI(STANDARD(function))(void *c) { return instance_unsupported(c, TEXT(STANDARD(function))); }
#define NO_VARIABLES(function)                                                          \
    API FMI(STANDARD(function))(void *c, const Ref vr[], size_t n)                      \
    {                                                                                   \
        return c && n == 0 ? OK : instance_unsupported(c, TEXT(STANDARD(function)));    \
    }
#define WITHOUT(type) NO_VARIABLES(Get##type) NO_VARIABLES(Set##type)

/* What is the same in both. */
EXPORT void FMI(STANDARD(FreeInstance))(void *c) { instance_free(c); }
API FMI(STANDARD(ExitInitializationMode))(void *c) { return instance_exit_initialisation(c); }
API FMI(STANDARD(Terminate))(void *c) { return instance_terminate(c); }
API FMI(STANDARD(Reset))(void *c) { return instance_reset(c); }
WITHOUT(Boolean)
WITHOUT(String)
UNSUPPORTED(GetDirectionalDerivative)
UNSUPPORTED(EnterEventMode)
UNSUPPORTED(EnterContinuousTimeMode)
UNSUPPORTED(CompletedIntegratorStep)
UNSUPPORTED(SetTime)
UNSUPPORTED(SetContinuousStates)
UNSUPPORTED(GetEventIndicators)
UNSUPPORTED(GetContinuousStates)
UNSUPPORTED(GetNominalsOfContinuousStates)

#endif
