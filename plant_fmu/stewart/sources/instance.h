/* What the FMI 2 and FMI 3 faces share: an instance, its log, its memory. */
#ifndef STEWART_INSTANCE_H
#define STEWART_INSTANCE_H

#include <stddef.h>

#include "plant.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define API EXPORT int
#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)
/* Numbers of both standards' status enumerations. */
typedef enum { OK, WARNING, DISCARD, ERROR } Status;

typedef struct Instance Instance;
typedef void (*Function)(void); /* of any type, cast back before it is called */
typedef void (*Report)(const Instance *instance, Status status, const char *message);

struct Instance {
    Plant plant;
    int logging;
    char name[128];
    Report report;
    void *environment; /* given back to the importer's logger */
    Function logger;
};

Instance *instance_new(const char *name, const char *token, int logging, Report report, void *environment,
                       Function logger);
void instance_free(Instance *instance);
Status instance_set_logging(Instance *instance, int on, size_t n, const char *const categories[]);
Status instance_fail(const Instance *instance, const char *message);
Status instance_unsupported(const Instance *instance, const char *function);

Status instance_enter_initialisation(Instance *instance, double start_time);
Status instance_exit_initialisation(Instance *instance);
Status instance_terminate(Instance *instance);
Status instance_reset(Instance *instance);
Status instance_step(Instance *instance, double time, double dt);

/* Saved state: a copy of the plant behind a header that names this build. */
Status instance_save(const Instance *instance, void **state);
Status instance_restore(Instance *instance, const void *state);
Status instance_discard(void **state);
Status instance_saved_size(const Instance *instance, const void *state, size_t *size);
Status instance_serialise(const Instance *instance, const void *state, unsigned char *bytes, size_t size);
Status instance_deserialise(const Instance *instance, const unsigned char *bytes, size_t size, void **state);

#endif
