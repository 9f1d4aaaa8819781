/* Common part of both FMI interfaces: an instance, its log and saved state, reading and writing of values, and
 * unsupported functions. Every binary has one of the interfaces.
 * The including file first defines: Ref and Logger; LOG(instance, message), which calls the logger; STANDARD(name),
 * as fmi2Name; FMI(name), with the importer's prefix; STATE(before, after), as before ## FMUstate ## after, and
 * DESERIALISE, both as the standard spells them; TYPE_OF(ref), -1 for an unknown one; OFFSET(ref) and COUNT(ref), the
 * elements of a value reference in Plant.v; VALUES(T), the parameters for the values, and N_GIVEN, their number. */
#ifndef STEWART_FACE_H
#define STEWART_FACE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "plant.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define API EXPORT int
#define SHARED(name) API FMI(STANDARD(name))
#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)
#define TEXT2(name) #name
#define TEXT(name) TEXT2(name)
#ifdef LS_BUS
#define START drives_start
#define STEP drives_step
#else
#define START(plant, why) 0
#define STEP plant_step
#endif

/* The standard fixes the signatures, so some parameters are unused. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

/* Numbers of both standards' status enumerations. */
typedef enum { OK = 0, ERROR = 3 } Status;

typedef struct {
    Plant plant;
    char name[128];
    void *environment; /* argument for the importer's logger */
    Logger logger;
} Instance;

/* A saved state: a header that identifies this build, then a copy of the plant. */
typedef struct {
    char token[48];
    Plant plant;
} Saved;

/* An error is always reported, also without logging: the importer needs the reason for a failed call. */
static Status instance_fail(const Instance *instance, const char *message)
{
    if (instance && instance->logger) LOG(instance, message);
    return ERROR;
}

static Status instance_unsupported(const Instance *instance, const char *function)
{
    char text[REASON_SIZE];
    snprintf(text, sizeof text, "%s is not supported by this co-simulation FMU", function);
    return instance_fail(instance, text);
}

/* NULL for the token of another build, and if the importer requests something `unsupported`. */
static Instance *instance_new(const char *name, const char *token, void *environment, Logger logger,
                              const char *unsupported)
{
    Instance *instance = calloc(1, sizeof *instance);
    if (!instance) return NULL;
    instance->environment = environment, instance->logger = logger;
    snprintf(instance->name, sizeof instance->name, "%s", name ? name : "");
    plant_reset(&instance->plant);
    if (!token || strcmp(token, TOKEN) != 0)
        instance_fail(instance, "the instantiation token is not that of this binary: model description and binary "
                                "belong to different builds");
    else if (unsupported) instance_unsupported(instance, unsupported);
    else return instance;
    free(instance);
    return NULL;
}

static Status instance_enter_initialisation(Instance *instance, double start_time)
{
    if (!instance || instance->plant.mode != INSTANTIATED)
        return instance_fail(instance, "initialisation can only be entered after instantiation or reset");
    if (!isfinite(start_time)) return instance_fail(instance, "the start time is not finite");
    instance->plant.start_time = instance->plant.v.time = start_time;
    instance->plant.mode = INITIALISING;
    instance->plant.fresh = 0;
    return OK;
}

static Status instance_step(Instance *instance, double time, double dt)
{
    char why[REASON_SIZE];
    if (!instance || instance->plant.mode != STEPPING)
        return instance_fail(instance, "a step needs an initialised instance");
    return STEP(&instance->plant, time, dt, why) == 0 ? OK : instance_fail(instance, why);
}

SHARED(SetDebugLogging)(const Instance *instance, int on, size_t n, const char *const categories[])
{
    return instance ? OK : ERROR;
}

SHARED(ExitInitializationMode)(Instance *instance)
{
    char why[REASON_SIZE];
    if (!instance || instance->plant.mode != INITIALISING)
        return instance_fail(instance, "initialisation has not been entered");
    const int failed = plant_initialise(&instance->plant, why) || START(&instance->plant, why);
    instance->plant.mode = failed ? BROKEN : STEPPING;
    return failed ? instance_fail(instance, why) : OK;
}

SHARED(Terminate)(Instance *instance)
{
    if (!instance || instance->plant.mode != STEPPING)
        return instance_fail(instance, "only an initialised instance can terminate");
    instance->plant.mode = TERMINATED;
    return OK;
}

SHARED(Reset)(Instance *instance)
{
    if (!instance) return ERROR;
    plant_reset(&instance->plant);
    return OK;
}

EXPORT void FMI(STANDARD(FreeInstance))(Instance *instance) { free(instance); }

SHARED(STATE(Get, ))(const Instance *instance, Saved **state)
{
    if (!instance || !state) return ERROR;
    if (!*state) *state = calloc(1, sizeof **state);
    if (!*state) return instance_fail(instance, "no memory for the state");
    strncpy((*state)->token, TOKEN, sizeof(*state)->token - 1);
    (*state)->plant = instance->plant;
    return OK;
}

SHARED(STATE(Set, ))(Instance *instance, const Saved *state)
{
    if (!instance || !state) return ERROR;
    if (strcmp(state->token, TOKEN) != 0) return instance_fail(instance, "the state was saved by another build");
    instance->plant = state->plant;
    return OK;
}

SHARED(STATE(Free, ))(const Instance *instance, Saved **state)
{
    if (!instance || !state) return ERROR;
    free(*state);
    *state = NULL;
    return OK;
}

SHARED(STATE(Serialized, Size))(const Instance *instance, const Saved *state, size_t *size)
{
    if (!instance || !state || !size) return ERROR;
    *size = sizeof *state;
    return OK;
}

SHARED(STATE(Serialize, ))(const Instance *instance, const Saved *state, void *bytes, size_t size)
{
    if (!instance || !state || !bytes) return ERROR;
    if (size < sizeof *state) return instance_fail(instance, "the buffer is smaller than the serialised state");
    memcpy(bytes, state, sizeof *state);
    return OK;
}

SHARED(DESERIALISE)(const Instance *instance, const Saved *bytes, size_t size, Saved **state)
{
    if (!instance || !bytes || !state) return ERROR;
    if (size != sizeof *bytes || strncmp(bytes->token, TOKEN, sizeof bytes->token) != 0)
        return instance_fail(instance, "these bytes are not a state of this build");
    if (!*state) *state = malloc(sizeof *bytes);
    if (!*state) return instance_fail(instance, "no memory for the state");
    memcpy(*state, bytes, sizeof *bytes);
    return OK;
}

/* Check that all references are known and of this type, and that their elements are as many as the values. */
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
    SHARED(get)(Instance *instance, const Ref vr[], size_t n, VALUES(T))                                           \
    {                                                                                                              \
        char why[REASON_SIZE];                                                                                     \
        if (!instance || fits(instance, vr, n, N_GIVEN, TYPE) != OK) return ERROR;                                 \
        for (size_t i = 0; i < n; i++) {                                                                           \
            if (plant_refresh(&instance->plant, OFFSET(vr[i]), why) != 0) return instance_fail(instance, why);     \
            for (int k = 0; k < COUNT(vr[i]); k++) *values++ = (T)VALUE(&instance->plant, OFFSET(vr[i]) + k);      \
        }                                                                                                          \
        return OK;                                                                                                 \
    }                                                                                                              \
    SHARED(set)(Instance *instance, const Ref vr[], size_t n, VALUES(const T))                                     \
    {                                                                                                              \
        char why[REASON_SIZE];                                                                                     \
        if (!instance || fits(instance, vr, n, N_GIVEN, TYPE) != OK) return ERROR;                                 \
        const T *value = values;                                                                                   \
        for (size_t i = 0; i < n; i++)                                                                             \
            for (int k = 0; k < COUNT(vr[i]); k++)                                                                 \
                if (plant_check(&instance->plant, OFFSET(vr[i]) + k, (double)*value++, why) != 0)                  \
                    return instance_fail(instance, why);                                                           \
        for (size_t i = 0; i < n; i++)                                                                             \
            for (int k = 0; k < COUNT(vr[i]); k++) VALUE(&instance->plant, OFFSET(vr[i]) + k) = (double)*values++; \
        instance->plant.fresh = 0;                                                                                 \
        return OK;                                                                                                 \
    }

/* Functions of the standard that this FMU does not support, and functions of types without variables, which accept
 * an empty list. They declare only the parameters that they read: on all our targets the caller removes the rest. */
#define UNSUPPORTED(function) \
    SHARED(function)(const Instance *instance) { return instance_unsupported(instance, TEXT(STANDARD(function))); }
#define BOTH_UNSUPPORTED(what) UNSUPPORTED(Get##what) UNSUPPORTED(Set##what)
#define NO_VARIABLES(function)                                                                      \
    SHARED(function)(const Instance *instance, const Ref vr[], size_t n)                            \
    {                                                                                               \
        return instance && n == 0 ? OK : instance_unsupported(instance, TEXT(STANDARD(function)));  \
    }
#define WITHOUT(type) NO_VARIABLES(Get##type) NO_VARIABLES(Set##type)

WITHOUT(Boolean)
WITHOUT(String)
BOTH_UNSUPPORTED(ContinuousStates)
UNSUPPORTED(GetDirectionalDerivative)
UNSUPPORTED(EnterContinuousTimeMode)
UNSUPPORTED(CompletedIntegratorStep)
UNSUPPORTED(SetTime)
UNSUPPORTED(GetEventIndicators)
UNSUPPORTED(GetNominalsOfContinuousStates)

#endif
