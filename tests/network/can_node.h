/* The interface of the CAN FMUs for tests. The including file defines Node before, and the hooks after it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { RX_DATA = 1, TX_DATA = 2, RX_CLOCK = 3, TX_CLOCK = 4 };
typedef fmi3Status Status;
typedef const fmi3ValueReference Refs[];

static void begin(Node* n);                   /* a new instance */
static void tick(Node* n);                    /* the Tx clock ticks */
static void take(Node* n);                    /* operations in rx */
static void stepped(Node* n, double from, double* reached, bool* event, bool* early);
static bool wait(const Node* n, double* seconds); /* to the next tick of a countdown; false: unknown */

static void put(Node* n, const void* data, size_t size) {
    memcpy(n->tx + n->tx_size, data, size);
    n->tx_size += size;
}

FMI3_Export const char* fmi3GetVersion(void) { return "3.0"; }

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, Refs required, size_t count, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Node* n = events ? calloc(1, sizeof(Node)) : NULL;
    if (n) begin(n);
    return n;
}

FMI3_Export void fmi3FreeInstance(fmi3Instance n) { free(n); }
FMI3_Export Status fmi3EnterInitializationMode(
    fmi3Instance n, fmi3Boolean a, fmi3Float64 b, fmi3Float64 c, fmi3Boolean d, fmi3Float64 e) {
    return fmi3OK;
}
FMI3_Export Status fmi3ExitInitializationMode(fmi3Instance n) { return fmi3OK; }
FMI3_Export Status fmi3EnterEventMode(fmi3Instance n) { return fmi3OK; }
FMI3_Export Status fmi3EnterStepMode(fmi3Instance n) { return fmi3OK; }
FMI3_Export Status fmi3Terminate(fmi3Instance n) { return fmi3OK; }

FMI3_Export Status fmi3SetClock(fmi3Instance n, Refs r, size_t count, const fmi3Clock values[]) {
    if (r[0] == TX_CLOCK) tick(n);
    return fmi3OK;
}

FMI3_Export Status fmi3SetBinary(
    fmi3Instance i, Refs r, size_t count, const size_t sizes[], const fmi3Binary values[], size_t number) {
    Node* n = i;
    if (r[0] != RX_DATA || sizes[0] > sizeof n->rx) return fmi3Error;
    memcpy(n->rx, values[0], n->rx_size = sizes[0]);
    return fmi3OK;
}

FMI3_Export Status fmi3GetBinary(
    fmi3Instance i, Refs r, size_t count, size_t sizes[], fmi3Binary values[], size_t number) {
    Node* n = i;
    values[0] = n->tx, sizes[0] = n->tx_size, n->taken = true;
#ifdef LIE
    sizes[0] = LIE;
#endif
#ifdef NO_DATA
    values[0] = NULL;
#endif
    return r[0] == TX_DATA ? fmi3OK : fmi3Error;
}

FMI3_Export Status fmi3UpdateDiscreteStates(
    fmi3Instance i, fmi3Boolean* more, fmi3Boolean* end, fmi3Boolean* nominals, fmi3Boolean* values,
    fmi3Boolean* defined, fmi3Float64* next) {
    Node* n = i;
    *more = *end = *nominals = *values = *defined = false;
    if (n->taken) n->tx_size = 0, n->taken = false;
    take(n);
    n->rx_size = 0;
    return fmi3OK;
}

FMI3_Export Status fmi3GetIntervalDecimal(
    fmi3Instance n, Refs r, size_t count, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]) {
    qualifiers[0] = wait(n, intervals) ? fmi3IntervalChanged : fmi3IntervalNotYetKnown;
    return fmi3OK;
}

FMI3_Export Status fmi3DoStep(
    fmi3Instance i, fmi3Float64 at, fmi3Float64 step, fmi3Boolean no_set, fmi3Boolean* event,
    fmi3Boolean* end, fmi3Boolean* early, fmi3Float64* last) {
    Node* n = i;
    n->now = llround(1e9 * (at + step));
    *end = *early = *event = false, *last = at + step;
    stepped(n, at, last, event, early);
    return fmi3OK;
}
