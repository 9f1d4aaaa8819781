#include "instance.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    char token[48];
    Plant plant;
} Saved;

Instance *instance_new(const char *name, const char *token, int logging, Report report, void *environment,
                       Function logger)
{
    Instance *instance = calloc(1, sizeof *instance);
    if (!instance) return NULL;
    instance->logging = logging, instance->report = report;
    instance->environment = environment, instance->logger = logger;
    snprintf(instance->name, sizeof instance->name, "%s", name ? name : "");
    if (!token || strcmp(token, TOKEN) != 0) {
        instance_fail(instance, "the instantiation token is not that of this binary: model description and binary "
                                "belong to different builds");
        free(instance);
        return NULL;
    }
    plant_reset(&instance->plant);
    return instance;
}

void instance_free(Instance *instance) { free(instance); }

Status instance_set_logging(Instance *instance, int on, size_t n, const char *const categories[])
{
    if (!instance) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!categories[i] || strcmp(categories[i], "logStatusError") != 0)
            return instance_fail(instance, "unknown log category");
    instance->logging = on;
    return OK;
}

Status instance_fail(const Instance *instance, const char *message)
{
    /* An error is always reported: whoever asked for no log still has to learn why a call failed. */
    if (instance && instance->report) instance->report(instance, ERROR, message);
    return ERROR;
}

Status instance_unsupported(const Instance *instance, const char *function)
{
    char text[REASON_SIZE];
    snprintf(text, sizeof text, "%s is not supported by this co-simulation FMU", function);
    return instance_fail(instance, text);
}

Status instance_enter_initialisation(Instance *instance, double start_time)
{
    if (!instance) return ERROR;
    if (instance->plant.mode != INSTANTIATED)
        return instance_fail(instance, "initialisation can only be entered after instantiation or reset");
    if (!isfinite(start_time)) return instance_fail(instance, "the start time is not finite");
    instance->plant.start_time = start_time;
    instance->plant.mode = INITIALISING;
    instance->plant.fresh = 0;
    return OK;
}

Status instance_exit_initialisation(Instance *instance)
{
    char why[REASON_SIZE];
    if (!instance) return ERROR;
    if (instance->plant.mode != INITIALISING) return instance_fail(instance, "initialisation has not been entered");
    if (plant_initialise(&instance->plant, why) != 0) {
        instance->plant.mode = BROKEN;
        return instance_fail(instance, why);
    }
    instance->plant.mode = STEPPING;
    return OK;
}

Status instance_terminate(Instance *instance)
{
    if (!instance) return ERROR;
    if (instance->plant.mode != STEPPING) return instance_fail(instance, "only an initialised instance can terminate");
    instance->plant.mode = TERMINATED;
    return OK;
}

Status instance_reset(Instance *instance)
{
    if (!instance) return ERROR;
    plant_reset(&instance->plant);
    return OK;
}

Status instance_step(Instance *instance, double time, double dt)
{
    char why[REASON_SIZE];
    if (!instance) return ERROR;
    if (instance->plant.mode != STEPPING) return instance_fail(instance, "a step needs an initialised instance");
    return plant_step(&instance->plant, time, dt, why) == 0 ? OK : instance_fail(instance, why);
}

Status instance_save(const Instance *instance, void **state)
{
    if (!instance || !state) return ERROR;
    if (!*state) *state = calloc(1, sizeof(Saved));
    if (!*state) return instance_fail(instance, "no memory for the state");
    Saved *saved = *state;
    strncpy(saved->token, TOKEN, sizeof saved->token - 1);
    saved->plant = instance->plant;
    return OK;
}

Status instance_restore(Instance *instance, const void *state)
{
    if (!instance || !state) return ERROR;
    const Saved *saved = state;
    if (strcmp(saved->token, TOKEN) != 0) return instance_fail(instance, "the state was saved by another build");
    instance->plant = saved->plant;
    return OK;
}

Status instance_discard(void **state)
{
    if (!state) return ERROR;
    free(*state);
    *state = NULL;
    return OK;
}

Status instance_saved_size(const Instance *instance, const void *state, size_t *size)
{
    if (!instance || !state || !size) return ERROR;
    *size = sizeof(Saved);
    return OK;
}

Status instance_serialise(const Instance *instance, const void *state, unsigned char *bytes, size_t size)
{
    if (!instance || !state || !bytes) return ERROR;
    if (size < sizeof(Saved)) return instance_fail(instance, "the buffer is smaller than the serialised state");
    memcpy(bytes, state, sizeof(Saved));
    return OK;
}

Status instance_deserialise(const Instance *instance, const unsigned char *bytes, size_t size, void **state)
{
    if (!instance || !bytes || !state) return ERROR;
    const Saved *saved = (const Saved *)(const void *)bytes;
    if (size != sizeof(Saved) || strncmp(saved->token, TOKEN, sizeof saved->token) != 0)
        return instance_fail(instance, "these bytes are no state of this build");
    if (!*state) *state = malloc(sizeof(Saved));
    if (!*state) return instance_fail(instance, "no memory for the state");
    memcpy(*state, bytes, sizeof(Saved));
    return OK;
}
