/* FMI 3.0 co-simulation around cellwise_ekf.c: the estimator, or the cell alone (CELLWISE_FMU_CELL), which
 * is the same step without a voltage. One step of CELLWISE_DT_S for every such time that a doStep
 * reaches, with the inputs as they were set before it. fmu_variables.h is written by `cellwise export`. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#include "cellwise_cell.h"
#include "fmu_variables.h"

/* Value references, as in modelDescription.xml; inputs and parameters from FMU_FIRST_SET on. */
enum {
    FMU_TIME, FMU_SOC, FMU_SOC_STD, FMU_PREDICTED_V, FMU_INNOVATION_V,
    FMU_DISCHARGE_W, FMU_CHARGE_LOW_W = FMU_DISCHARGE_W + 3,
    FMU_REMAINING_S, FMU_REMAINING_HIGH_S = FMU_REMAINING_S + 2,
    FMU_STATUS,
    FMU_FIRST_SET = 20, FMU_SETTABLE = 5
};
enum { CURRENT_A, TEMPERATURE_C, VOLTAGE_V, SOC0, SOC0_STD }; /* from FMU_FIRST_SET */

/* Everything an instance holds: plain bytes, so that a copy of them is its FMU state. */
typedef struct {
    cellwise_state state;
    cellwise_output out;
    double set[FMU_SETTABLE];
    double time_s;
    double start_s;
    double steps; /* taken since start_s; a whole number */
    uint32_t sequence;
} fmu_values;

typedef struct {
    fmu_values now;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} fmu_instance;

static fmi3Status refuse(const fmu_instance *f, const char *message)
{
    if (f != NULL && f->log != NULL) {
        f->log(f->environment, fmi3Error, "logStatusError", message);
    }
    return fmi3Error;
}

static void sample(fmu_values *now, double current_A)
{
    cellwise_input in;
    in.current_A = (float)current_A;
    in.voltage_V = CELLWISE_FMU_CELL ? NAN : (float)now->set[VOLTAGE_V];
    in.temperature_C = (float)now->set[TEMPERATURE_C];
    in.sequence = now->sequence;
    (void)cellwise_step(&cellwise_cell, &now->state, &in, &now->out);
    now->sequence++;
}

/* Before the first sample: the SOC as stated. A cell begins at rest, so its voltage is known then. */
static fmi3Status begin(fmu_instance *f)
{
    static const cellwise_output none;
    fmu_values *const now = &f->now;
    const float variance = (float)(now->set[SOC0_STD] * now->set[SOC0_STD]);
    now->out = none;
    now->sequence = 0u;
    now->steps = 0.0;
    if (cellwise_init(&cellwise_cell, &now->state, (float)now->set[SOC0], variance) != 0u) {
        return refuse(f, "found a soc0 or soc0_std that is none; expected soc0 from 0 to 1, soc0_std above 0 up to 1");
    }
    now->out.soc = now->state.soc;
    now->out.soc_variance = now->state.ss;
#if CELLWISE_FMU_CELL
    sample(now, 0.0);
#endif
    return fmi3OK;
}

static double read_output(const fmu_values *now, fmi3ValueReference r)
{
#if CELLWISE_POWER
    if (r >= FMU_DISCHARGE_W && r <= FMU_CHARGE_LOW_W) {
        cellwise_capability able;
        cellwise_power(&cellwise_cell, &now->state, &able);
        return (double)(&able.discharge_W)[r - FMU_DISCHARGE_W];
    }
#endif
#if CELLWISE_REMAINING
    if (r >= FMU_REMAINING_S && r <= FMU_REMAINING_HIGH_S) {
        cellwise_outlook ahead;
        cellwise_remaining(&cellwise_cell, &now->state, now->state.current_A, true, &ahead);
        return (double)(&ahead.time_s)[r - FMU_REMAINING_S];
    }
#endif
    switch (r) {
    case FMU_SOC: return (double)now->out.soc;
    case FMU_PREDICTED_V: return (double)now->out.voltage_V;
    case FMU_SOC_STD: return sqrt((double)now->out.soc_variance);
    case FMU_INNOVATION_V: return (double)now->out.innovation_V;
    default: return now->time_s;
    }
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String c[])
{
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference between[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    fmu_instance *f;
    f = calloc(1u, sizeof *f);
    if (f == NULL) {
        return NULL;
    }
    f->environment = environment;
    f->log = log;
    if (token == NULL || strcmp(token, FMU_TOKEN) != 0) {
        (void)refuse(f, "found another instantiationToken; expected that of the modelDescription.xml beside it");
        free(f);
        return NULL;
    }
    (void)fmi3Reset(f);
    return f;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerant, fmi3Float64 tolerance,
                                       fmi3Float64 start_s, fmi3Boolean ends, fmi3Float64 stop_s)
{
    fmu_instance *const f = instance;
    (void)tolerant, (void)tolerance, (void)ends, (void)stop_s;
    f->now.start_s = start_s;
    f->now.time_s = start_s;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return begin(instance);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 at_s, fmi3Float64 step_s, fmi3Boolean forward,
                      fmi3Boolean *event, fmi3Boolean *stop, fmi3Boolean *early, fmi3Float64 *last_s)
{
    fmu_instance *const f = instance;
    fmu_values *const now = &f->now;
    double due;
    *event = *stop = *early = false;
    *last_s = now->time_s;
    if (!(step_s >= 0.0) || !(fabs(at_s - now->time_s) <= 1e-6 * (double)CELLWISE_DT_S + 1e-9 * fabs(at_s))) {
        return refuse(f, "found a step that is not from where the last one ended; expected steps in order, or an FMU state that was set");
    }
    now->time_s = at_s + step_s;
    /* The float32 of the time step is not what was asked for: FMU_DT_S is. */
    due = floor((now->time_s - now->start_s) / FMU_DT_S + 1e-6);
    for (; now->steps < due; now->steps += 1.0) {
        sample(now, now->set[CURRENT_A]);
    }
    *last_s = now->time_s;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    static const double start[FMU_SETTABLE] = FMU_START;
    memcpy(((fmu_instance *)instance)->now.set, start, sizeof start);
    return begin(instance);
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t values)
{
    const fmu_instance *const f = instance;
    size_t k;
    for (k = 0u; k < n; k++) {
        v[k] = r[k] - FMU_FIRST_SET < FMU_SETTABLE ? f->now.set[r[k] - FMU_FIRST_SET] : read_output(&f->now, r[k]);
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n,
                          const fmi3Float64 v[], size_t values)
{
    fmu_instance *const f = instance;
    size_t k;
    for (k = 0u; k < n; k++) {
        if (r[k] - FMU_FIRST_SET >= FMU_SETTABLE) {
            return refuse(f, "found a value reference that is neither input nor parameter");
        }
        f->now.set[r[k] - FMU_FIRST_SET] = v[k];
    }
    return fmi3OK;
}

fmi3Status fmi3GetUInt32(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt32 v[],
                         size_t values)
{
    const fmu_instance *const f = instance;
    size_t k;
    for (k = 0u; k < n; k++) {
        if (r[k] != FMU_STATUS) {
            return refuse(f, "found a value reference that is no UInt32 of this FMU");
        }
        v[k] = f->now.out.status & ~FMU_STATUS_NOT_SHOWN;
    }
    return fmi3OK;
}

static fmi3Status keep(const fmu_instance *f, const void *bytes, fmi3FMUState *kept)
{
    if (*kept == NULL) {
        *kept = malloc(sizeof(fmu_values));
    }
    if (*kept == NULL) {
        return refuse(f, "found no memory for the state");
    }
    memcpy(*kept, bytes, sizeof(fmu_values));
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *kept)
{
    return keep(instance, &((fmu_instance *)instance)->now, kept);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState kept)
{
    memcpy(&((fmu_instance *)instance)->now, kept, sizeof(fmu_values));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *kept)
{
    free(*kept);
    *kept = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState kept, size_t *size)
{
    *size = sizeof(fmu_values);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState kept, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(fmu_values)) {
        return refuse(instance, "found too few bytes for the state");
    }
    memcpy(bytes, kept, sizeof(fmu_values));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *kept)
{
    if (size != sizeof(fmu_values)) {
        return refuse(instance, "found bytes that are no state of this FMU");
    }
    return keep(instance, bytes, kept);
}

/* What this FMU has none of: the standard wants the functions all the same. */
#define REFS fmi3Instance instance, const fmi3ValueReference r[], size_t n
#define NONE(n) ((n) == 0u ? fmi3OK : refuse(instance, "found a call for what this FMU has none of"))
#define NO_VALUES(Type, name)                                                     \
    fmi3Status fmi3Get##name(REFS, Type v[], size_t values)                       \
    {                                                                             \
        return NONE(n);                                                           \
    }                                                                             \
    NO_SETTING(Type, name)
#define NO_SETTING(Type, name)                                                    \
    fmi3Status fmi3Set##name(REFS, const Type v[], size_t values)                 \
    {                                                                             \
        return NONE(n);                                                           \
    }
#define NO_CALL(name, arguments) \
    fmi3Status name arguments    \
    {                            \
        return NONE(1u);         \
    }

NO_VALUES(fmi3Float32, Float32)
NO_VALUES(fmi3Int8, Int8)
NO_VALUES(fmi3UInt8, UInt8)
NO_VALUES(fmi3Int16, Int16)
NO_VALUES(fmi3UInt16, UInt16)
NO_VALUES(fmi3Int32, Int32)
NO_SETTING(fmi3UInt32, UInt32)
NO_VALUES(fmi3Int64, Int64)
NO_VALUES(fmi3UInt64, UInt64)
NO_VALUES(fmi3Boolean, Boolean)
NO_VALUES(fmi3String, String)
NO_CALL(fmi3GetBinary, (REFS, size_t s[], fmi3Binary v[], size_t m))
NO_CALL(fmi3SetBinary, (REFS, const size_t s[], const fmi3Binary v[], size_t m))
NO_CALL(fmi3GetClock, (REFS, fmi3Clock v[]))
NO_CALL(fmi3SetClock, (REFS, const fmi3Clock v[]))
NO_CALL(fmi3GetIntervalDecimal, (REFS, fmi3Float64 v[], fmi3IntervalQualifier q[]))
NO_CALL(fmi3GetIntervalFraction, (REFS, fmi3UInt64 c[], fmi3UInt64 s[], fmi3IntervalQualifier q[]))
NO_CALL(fmi3GetShiftDecimal, (REFS, fmi3Float64 v[]))
NO_CALL(fmi3GetShiftFraction, (REFS, fmi3UInt64 c[], fmi3UInt64 s[]))
NO_CALL(fmi3SetIntervalDecimal, (REFS, const fmi3Float64 v[]))
NO_CALL(fmi3SetIntervalFraction, (REFS, const fmi3UInt64 c[], const fmi3UInt64 s[]))
NO_CALL(fmi3SetShiftDecimal, (REFS, const fmi3Float64 v[]))
NO_CALL(fmi3SetShiftFraction, (REFS, const fmi3UInt64 c[], const fmi3UInt64 s[]))
NO_CALL(fmi3GetOutputDerivatives, (REFS, const fmi3Int32 o[], fmi3Float64 v[], size_t m))
NO_CALL(fmi3GetNumberOfVariableDependencies, (fmi3Instance instance, fmi3ValueReference r, size_t *n))
NO_CALL(fmi3GetVariableDependencies,
        (fmi3Instance instance, fmi3ValueReference r, size_t a[], fmi3ValueReference i[], size_t b[],
         fmi3DependencyKind k[], size_t n))
NO_CALL(fmi3GetDirectionalDerivative,
        (REFS, const fmi3ValueReference k[], size_t m, const fmi3Float64 s[], size_t p, fmi3Float64 v[],
         size_t q))
NO_CALL(fmi3GetAdjointDerivative,
        (REFS, const fmi3ValueReference k[], size_t m, const fmi3Float64 s[], size_t p, fmi3Float64 v[],
         size_t q))
NO_CALL(fmi3EnterEventMode, (fmi3Instance instance))
NO_CALL(fmi3EnterConfigurationMode, (fmi3Instance instance))
NO_CALL(fmi3ExitConfigurationMode, (fmi3Instance instance))
NO_CALL(fmi3EnterContinuousTimeMode, (fmi3Instance instance))
NO_CALL(fmi3EnterStepMode, (fmi3Instance instance))
NO_CALL(fmi3EvaluateDiscreteStates, (fmi3Instance instance))
NO_CALL(fmi3UpdateDiscreteStates,
        (fmi3Instance instance, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *c, fmi3Boolean *d,
         fmi3Boolean *e, fmi3Float64 *f))
NO_CALL(fmi3CompletedIntegratorStep,
        (fmi3Instance instance, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *c))
NO_CALL(fmi3SetTime, (fmi3Instance instance, fmi3Float64 t))
NO_CALL(fmi3SetContinuousStates, (fmi3Instance instance, const fmi3Float64 x[], size_t n))
NO_CALL(fmi3GetContinuousStates, (fmi3Instance instance, fmi3Float64 x[], size_t n))
NO_CALL(fmi3GetContinuousStateDerivatives, (fmi3Instance instance, fmi3Float64 x[], size_t n))
NO_CALL(fmi3GetNominalsOfContinuousStates, (fmi3Instance instance, fmi3Float64 x[], size_t n))
NO_CALL(fmi3GetEventIndicators, (fmi3Instance instance, fmi3Float64 x[], size_t n))
NO_CALL(fmi3GetNumberOfEventIndicators, (fmi3Instance instance, size_t *n))
NO_CALL(fmi3GetNumberOfContinuousStates, (fmi3Instance instance, size_t *n))
NO_CALL(fmi3ActivateModelPartition, (fmi3Instance instance, fmi3ValueReference r, fmi3Float64 t))
