/* The bus terminal of FMI-LS-BUS: event mode, clocks, binary variables. Part of fmi3.c. */
#ifndef STEWART_TERMINAL_H
#define STEWART_TERMINAL_H

enum { RX_DATA = N_VARIABLES, TX_DATA, RX_CLOCK, TX_CLOCK };
enum { INTERVAL_NOT_YET_KNOWN = 0, INTERVAL_CHANGED = 2 };

/* OK if an initialised instance is in event mode, or else in step mode. */
static Status in_mode(const Instance *instance, int event_mode)
{
    if (!instance) return ERROR;
    if (instance->plant.mode == STEPPING && instance->plant.drives.event_mode == event_mode) return OK;
    return instance_fail(instance, event_mode ? "this call needs event mode" : "this call needs step mode");
}

static Status change_mode(Instance *instance, int event_mode)
{
    if (in_mode(instance, !event_mode) != OK) return ERROR;
    instance->plant.drives.event_mode = event_mode;
    return OK;
}

API FMI(fmi3EnterEventMode)(Instance *instance) { return change_mode(instance, 1); }
API FMI(fmi3EnterStepMode)(Instance *instance) { return change_mode(instance, 0); }

static int *clock_of(Instance *instance, Ref vr)
{
    if (vr == RX_CLOCK) return &instance->plant.drives.rx_clock;
    if (vr == TX_CLOCK) return &instance->plant.drives.tx_clock;
    instance_fail(instance, "unknown value reference of a clock");
    return NULL;
}

API FMI(fmi3GetClock)(Instance *instance, const Ref vr[], size_t n, bool values[])
{
    if (!instance) return ERROR;
    for (size_t i = 0; i < n; i++) {
        const int *clock = clock_of(instance, vr[i]);
        if (!clock) return ERROR;
        values[i] = *clock != 0;
    }
    return OK;
}

API FMI(fmi3SetClock)(Instance *instance, const Ref vr[], size_t n, const bool values[])
{
    if (in_mode(instance, 1) != OK) return ERROR;
    for (size_t i = 0; i < n; i++) {
        int *clock = clock_of(instance, vr[i]);
        if (!clock) return ERROR;
        *clock = values[i];
    }
    return OK;
}

API FMI(fmi3GetBinary)(Instance *instance, const Ref vr[], size_t n, size_t sizes[], const uint8_t *values[],
                       size_t n_values)
{
    if (!instance || n != n_values) return instance_fail(instance, "as many values as value references are needed");
    Drives *d = &instance->plant.drives;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != RX_DATA && vr[i] != TX_DATA) return instance_fail(instance, "unknown value reference of a binary");
        sizes[i] = vr[i] == TX_DATA && d->tx_clock ? d->size : 0;
        if (sizes[i] > 0) d->taken = d->size;
        values[i] = d->operations;
    }
    return OK;
}

API FMI(fmi3SetBinary)(Instance *instance, const Ref vr[], size_t n, const size_t sizes[],
                       const uint8_t *const values[], size_t n_values)
{
    if (!instance || n != n_values) return instance_fail(instance, "as many values as value references are needed");
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != RX_DATA) return instance_fail(instance, "Rx_Data is the only binary variable that can be set");
        if (sizes[i] == 0) continue;
        if (!instance->plant.drives.rx_clock) return instance_fail(instance, "Rx_Data needs a tick of Rx_Clock");
        drives_receive(&instance->plant, values[i], sizes[i]);
    }
    return OK;
}

/* Operations that the importer has read are gone; those that have come since are for another tick. */
API FMI(fmi3UpdateDiscreteStates)(Instance *instance, bool *more, bool *terminate, bool *nominals, bool *states,
                                  bool *next_defined, double *next)
{
    if (in_mode(instance, 1) != OK) return ERROR;
    Drives *d = &instance->plant.drives;
    d->size -= d->taken;
    memmove(d->operations, d->operations + d->taken, d->size);
    d->taken = 0, d->rx_clock = d->tx_clock = 0;
    *more = *terminate = *nominals = *states = *next_defined = false;
    *next = 0.0;
    return OK;
}

API FMI(fmi3GetIntervalDecimal)(const Instance *instance, const Ref vr[], size_t n, double intervals[],
                                int qualifiers[])
{
    if (!instance) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != TX_CLOCK) return instance_fail(instance, "Tx_Clock is the only clock with an interval");
        const int64_t wait_ns = instance->plant.mode == STEPPING ? drives_wait(&instance->plant) : -1;
        intervals[i] = wait_ns < 0 ? 0.0 : (double)wait_ns * 1e-9;
        qualifiers[i] = wait_ns < 0 ? INTERVAL_NOT_YET_KNOWN : INTERVAL_CHANGED;
    }
    return OK;
}

#endif
