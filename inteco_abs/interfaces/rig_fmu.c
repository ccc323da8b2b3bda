/* The rig as an FMU for co-simulation, FMI 2.0 and 3.0. Above this stand, as written by inteco_abs/interfaces/fmu.py, the
   rig's functions, TOKEN, ROOM, STEP_S, and behind it `struct rig`'s start values and table of variables. The functions'
   declarations are those of the standard (https://fmi-standard.org), written out, so that no header is needed. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define PASTED(prefix, name) prefix##name
#define PREFIXED(prefix, name) PASTED(prefix, name)
#ifdef FMI2_FUNCTION_PREFIX
#define FMI2(name) PREFIXED(FMI2_FUNCTION_PREFIX, fmi2##name)
#else
#define FMI2(name) fmi2##name
#endif
#ifdef FMI3_FUNCTION_PREFIX
#define FMI3(name) PREFIXED(FMI3_FUNCTION_PREFIX, fmi3##name)
#else
#define FMI3(name) fmi3##name
#endif

enum status { OK, WARNING, DISCARD, ERROR };
enum mode { INSTANTIATED, INITIALISING, STEPPING };
enum kind { FLOAT, INTEGER, WORD, FLAG };
enum causality { INDEPENDENT, INPUT, OUTPUT, PARAMETER };

/* All that a simulation depends on, without an address: a saved state is a copy. */
struct rig {
    struct Constants k;
    struct State s;
    double due_s[ROOM];
    double torques[ROOM];
    double sent[MOST_DELAY + 1][2];
    int64_t steps;
    double start_s;
    double time_s;
    double initial_wheel_speed;
    double initial_road_speed;
    uint64_t seed;
    double drive_duty;
    double brake_duty;
    int64_t wheel_count;
    int64_t road_count;
    double slip;
    enum mode mode;
    char token[40];
};

struct variable {
    const char *name;
    size_t place;
    enum kind kind;
    enum causality causality;
    double low;
    double high;
};

static const struct rig START;
static const struct variable VARIABLES[VARIABLE_COUNT];

typedef void logger2(void *environment, const char *instance, int status, const char *category, const char *message, ...);
typedef void logger3(void *environment, int status, const char *category, const char *message);

struct callbacks2 {
    logger2 *log;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*step_finished)(void *environment, int status);
    void *environment;
};

struct instance {
    struct rig rig;
    logger2 *log_fmi2;
    logger3 *log_fmi3;
    void *environment;
    char name[64];
};

static enum status refuse(struct instance *c, const char *format, ...)
{
    char message[256];
    va_list values;
    va_start(values, format);
    vsnprintf(message, sizeof message, format, values);
    va_end(values);
    if (c->log_fmi2)
        c->log_fmi2(c->environment, c->name, ERROR, "logStatusError", message); /* no % in it: no more arguments */
    if (c->log_fmi3)
        c->log_fmi3(c->environment, ERROR, "logStatusError", message);
    return ERROR;
}

/* the rig */

static void observe(struct rig *rig)
{
    const struct of_int64_int64 counts = read_encoders(&rig->k, &rig->s, rig->steps + 1);
    rig->wheel_count = counts._0;
    rig->road_count = counts._1;
    rig->slip = rim_slip(rig->s.wheel_radius * rig->s.wheel_speed, rig->k.r2 * rig->s.road_speed);
    rig->time_s = rig->start_s + (double)rig->steps * STEP_S;
}

/* Begin with the present parameters, as Constants.of and Plant do. */
static void begin(struct rig *rig)
{
    struct Constants *k = &rig->k;
    const struct of_double_double lever = sin_cos(k->phi_rad);
    k->L_sin = k->L * lever._0;
    k->L_cos = k->L * lever._1;
    k->road_changes = 1;
    k->contact_rate = contact_rate(k->road_c1 * k->road_c2, k->later_c1 * k->later_c2);
    k->noise_seed = mixed(rig->seed ^ UINT64_MAX);
    rig->s = START.s;
    rig->s.wheel_speed = rig->initial_wheel_speed;
    rig->s.road_speed = rig->initial_road_speed;
    rig->s.L_sin = k->L_sin;
    rig->s.L_cos = k->L_cos;
    rig->s.grip = k->adhesion_scale;
    rig->s.wheel_radius = k->r1;
    rig->s.road_c1 = k->road_c1;
    rig->s.road_c2 = k->road_c2;
    rig->s.road_c3 = k->road_c3;
    rig->s.settled_torque = rig->s.newest_torque = rig->s.cold_torque = settled(k, 0.0);
    observe(rig);
}

/* A command acts the rig's own delay later. */
static bool step(struct rig *rig)
{
    const int64_t places = rig->k.command_delay_ticks + 1;
    double *newest = rig->sent[rig->steps % places], *acting = rig->sent[(rig->steps + 1) % places];
    const struct row_double due_s = {rig->due_s, ROOM}, torques = {rig->torques, ROOM};
    newest[0] = rig->drive_duty;
    newest[1] = rig->brake_duty;
    move_on(&rig->k, &rig->s, due_s, torques, acting[0], acting[1], STEP_S);
    rig->steps++;
    return isfinite(rig->s.wheel_speed) && isfinite(rig->s.road_speed) && isfinite(rig->s.brake_torque) &&
           fabs(rig->s.wheel_angle) < 1e12 && fabs(rig->s.road_angle) < 1e12;
}

static enum status advance(struct instance *c, double duration_s)
{
    const double steps = nearbyint(duration_s / STEP_S);
    if (c->rig.mode != STEPPING)
        return refuse(c, "a step before the initialisation has ended");
    if (!(steps >= 0.0 && steps < 1e12 && fabs(duration_s - steps * STEP_S) <= 1e-6 * STEP_S))
        return refuse(c, "a step of %.17g s: must be a multiple of %g s", duration_s, STEP_S);
    for (int64_t i = 0; i < (int64_t)steps; i++)
        if (!step(&c->rig))
            return refuse(c, "a number is not finite after %.17g s: the parameters fit no rig", c->rig.s.time_s);
    observe(&c->rig);
    return OK;
}

/* variables */

static const size_t SIZES[] = {sizeof(double), sizeof(int64_t), sizeof(uint64_t), sizeof(bool)};

static const struct variable *found(struct instance *c, unsigned reference, enum kind kind)
{
    if (reference < VARIABLE_COUNT && VARIABLES[reference].kind == kind)
        return &VARIABLES[reference];
    refuse(c, "value reference %u: no variable of this type", reference);
    return NULL;
}

static enum status get(struct instance *c, unsigned reference, enum kind kind, void *value)
{
    const struct variable *variable = found(c, reference, kind);
    if (!variable)
        return ERROR;
    if (c->rig.mode != STEPPING)
        begin(&c->rig);
    memcpy(value, (char *)&c->rig + variable->place, SIZES[kind]);
    return OK;
}

static enum status set(struct instance *c, unsigned reference, enum kind kind, const void *value)
{
    const struct variable *variable = found(c, reference, kind);
    double number = 0.0;
    int64_t whole = 0;
    if (!variable)
        return ERROR;
    if (variable->causality != INPUT && (variable->causality != PARAMETER || c->rig.mode == STEPPING))
        return refuse(c, "%s: only inputs can be set, and parameters before the initialisation ends", variable->name);
    if (kind == FLOAT)
        memcpy(&number, value, sizeof number);
    if (kind == INTEGER) {
        memcpy(&whole, value, sizeof whole);
        number = (double)whole;
    }
    if (!(number >= variable->low && number <= variable->high))
        return refuse(c, "%s = %.17g: must be in %g..%g", variable->name, number, variable->low, variable->high);
    memcpy((char *)&c->rig + variable->place, value, SIZES[kind]);
    return OK;
}

/* what both versions have */

static struct instance *instantiated(const char *name)
{
    struct instance *c = calloc(1, sizeof *c);
    if (c) {
        c->rig = START;
        snprintf(c->name, sizeof c->name, "%s", name ? name : "");
    }
    return c;
}

static struct instance *checked(struct instance *c, const char *token)
{
    if (!c || (token && strcmp(token, TOKEN) == 0))
        return c;
    refuse(c, "the model description is of another FMU than this binary: %s", TOKEN);
    free(c);
    return NULL;
}

static enum status enter_initialisation(struct instance *c)
{
    if (c->rig.mode != INSTANTIATED)
        return refuse(c, "the initialisation is behind; reset the instance");
    c->rig.mode = INITIALISING;
    return OK;
}

static enum status exit_initialisation(struct instance *c)
{
    if (c->rig.mode != INITIALISING)
        return refuse(c, "the initialisation has not begun");
    begin(&c->rig);
    c->rig.mode = STEPPING;
    return OK;
}

static enum status restart(struct instance *c)
{
    c->rig = START;
    return OK;
}

static enum status save(struct instance *c, struct rig **state)
{
    if (!*state)
        *state = malloc(sizeof **state);
    if (!*state)
        return refuse(c, "not enough memory");
    **state = c->rig;
    return OK;
}

static enum status restore(struct instance *c, struct rig *state)
{
    if (!state)
        return refuse(c, "no state to restore");
    c->rig = *state;
    return OK;
}

static enum status release(struct rig **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

static enum status serialise(struct instance *c, struct rig *state, char *bytes, size_t size)
{
    if (!state || size < sizeof *state)
        return refuse(c, "a saved state has %zu bytes, not %zu", sizeof *state, size);
    memcpy(bytes, state, sizeof *state);
    return OK;
}

static enum status deserialise(struct instance *c, const char *bytes, size_t size, struct rig **state)
{
    if (size != sizeof **state)
        return refuse(c, "a saved state has %zu bytes, not %zu", sizeof **state, size);
    if (strncmp(bytes + offsetof(struct rig, token), TOKEN, sizeof (*state)->token) != 0)
        return refuse(c, "the saved state is of another FMU");
    if (save(c, state) != OK)
        return ERROR;
    memcpy(*state, bytes, size);
    return OK;
}

#define IN_BOTH(name2, name3, parameters, call) \
    EXPORT int FMI2(name2) parameters { return call; } \
    EXPORT int FMI3(name3) parameters { return call; }

IN_BOTH(ExitInitializationMode, ExitInitializationMode, (struct instance *c), exit_initialisation(c))
IN_BOTH(Terminate, Terminate, (struct instance *c), c ? OK : ERROR)
IN_BOTH(Reset, Reset, (struct instance *c), restart(c))
IN_BOTH(GetFMUstate, GetFMUState, (struct instance *c, struct rig **state), save(c, state))
IN_BOTH(SetFMUstate, SetFMUState, (struct instance *c, struct rig *state), restore(c, state))
IN_BOTH(FreeFMUstate, FreeFMUState, (struct instance *c, struct rig **state), c ? release(state) : ERROR)
IN_BOTH(SerializedFMUstateSize, SerializedFMUStateSize, (struct instance *c, struct rig *state, size_t *size),
        c && state ? (*size = sizeof *state, OK) : ERROR)
IN_BOTH(SerializeFMUstate, SerializeFMUState, (struct instance *c, struct rig *state, char bytes[], size_t size),
        serialise(c, state, bytes, size))
IN_BOTH(DeSerializeFMUstate, DeserializeFMUState,
        (struct instance *c, const char bytes[], size_t size, struct rig **state), deserialise(c, bytes, size, state))

EXPORT void FMI2(FreeInstance)(struct instance *c) { free(c); }
EXPORT void FMI3(FreeInstance)(struct instance *c) { free(c); }
EXPORT const char *FMI2(GetVersion)(void) { return "2.0"; }
EXPORT const char *FMI3(GetVersion)(void) { return "3.0"; }

/* FMI 2.0 */

EXPORT const char *FMI2(GetTypesPlatform)(void) { return "default"; }

EXPORT struct instance *FMI2(Instantiate)(const char *name, int type, const char *guid, const char *resources,
                                          const struct callbacks2 *callbacks, int visible, int logging)
{
    struct instance *c = instantiated(name);
    (void)resources, (void)visible, (void)logging;
    if (c && callbacks) {
        c->log_fmi2 = callbacks->log;
        c->environment = callbacks->environment;
    }
    if (c && type != 1) {
        refuse(c, "for co-simulation only");
        free(c);
        return NULL;
    }
    return checked(c, guid);
}

EXPORT int FMI2(SetupExperiment)(struct instance *c, int with_tolerance, double tolerance, double start_s, int with_end,
                                 double end_s)
{
    (void)with_tolerance, (void)tolerance, (void)with_end, (void)end_s;
    c->rig.start_s = start_s;
    return OK;
}

EXPORT int FMI2(EnterInitializationMode)(struct instance *c) { return enter_initialisation(c); }

EXPORT int FMI2(GetReal)(struct instance *c, const unsigned references[], size_t count, double values[])
{
    enum status worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++)
        worst = get(c, references[i], FLOAT, &values[i]);
    return worst;
}

EXPORT int FMI2(SetReal)(struct instance *c, const unsigned references[], size_t count, const double values[])
{
    enum status worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++)
        worst = set(c, references[i], FLOAT, &values[i]);
    return worst;
}

static enum kind whole_kind(unsigned reference)
{
    return reference < VARIABLE_COUNT && VARIABLES[reference].kind == WORD ? WORD : INTEGER;
}

/* A counter has 64 bits, an Integer of FMI 2.0 the lower 32. */
EXPORT int FMI2(GetInteger)(struct instance *c, const unsigned references[], size_t count, int values[])
{
    enum status worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++) {
        uint64_t value = 0;
        worst = get(c, references[i], whole_kind(references[i]), &value);
        values[i] = (int)(uint32_t)value;
    }
    return worst;
}

EXPORT int FMI2(SetInteger)(struct instance *c, const unsigned references[], size_t count, const int values[])
{
    enum status worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++) {
        const int64_t value = values[i];
        if (value < 0 && whole_kind(references[i]) == WORD)
            worst = refuse(c, "%s = %d: must not be negative", VARIABLES[references[i]].name, values[i]);
        else
            worst = set(c, references[i], whole_kind(references[i]), &value);
    }
    return worst;
}

EXPORT int FMI2(GetBoolean)(struct instance *c, const unsigned references[], size_t count, int values[])
{
    enum status worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++) {
        bool value = false;
        worst = get(c, references[i], FLAG, &value);
        values[i] = value;
    }
    return worst;
}

EXPORT int FMI2(SetBoolean)(struct instance *c, const unsigned references[], size_t count, const int values[])
{
    enum status worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++) {
        const bool value = values[i] != 0;
        worst = set(c, references[i], FLAG, &value);
    }
    return worst;
}

EXPORT int FMI2(DoStep)(struct instance *c, double now_s, double duration_s, int never_back)
{
    (void)now_s, (void)never_back;
    return advance(c, duration_s);
}

EXPORT int FMI2(SetDebugLogging)(struct instance *c, int on, size_t count, const char *const categories[])
{
    (void)on, (void)count, (void)categories;
    return c ? OK : ERROR;
}

/* FMI 3.0 */

EXPORT struct instance *FMI3(InstantiateCoSimulation)(const char *name, const char *token, const char *resources,
                                                      bool visible, bool logging, bool events, bool early,
                                                      const unsigned intermediate[], size_t intermediate_count,
                                                      void *environment, logger3 *log, void *update)
{
    struct instance *c = instantiated(name);
    (void)resources, (void)visible, (void)logging, (void)early, (void)intermediate, (void)update;
    if (c) {
        c->log_fmi3 = log;
        c->environment = environment;
    }
    if (c && (events || intermediate_count)) {
        refuse(c, "without event mode and intermediate variables only");
        free(c);
        return NULL;
    }
    return checked(c, token);
}

EXPORT int FMI3(EnterInitializationMode)(struct instance *c, bool with_tolerance, double tolerance, double start_s,
                                         bool with_end, double end_s)
{
    (void)with_tolerance, (void)tolerance, (void)with_end, (void)end_s;
    c->rig.start_s = start_s;
    return enter_initialisation(c);
}

EXPORT int FMI3(DoStep)(struct instance *c, double now_s, double duration_s, bool never_back, bool *event,
                        bool *terminate, bool *early, double *reached_s)
{
    const enum status status = advance(c, duration_s);
    (void)never_back;
    *event = *terminate = *early = false;
    *reached_s = status == OK ? now_s + duration_s : now_s;
    return status;
}

#define ACCESS3(Name, type, kind) \
    EXPORT int FMI3(Get##Name)(struct instance *c, const unsigned references[], size_t count, type values[], size_t n) \
    { \
        enum status worst = count == n ? OK : refuse(c, "%zu values for %zu variables", n, count); \
        for (size_t i = 0; i < count && worst == OK; i++) \
            worst = get(c, references[i], kind, &values[i]); \
        return worst; \
    } \
    EXPORT int FMI3(Set##Name)(struct instance *c, const unsigned references[], size_t count, const type values[], \
                               size_t n) \
    { \
        enum status worst = count == n ? OK : refuse(c, "%zu values for %zu variables", n, count); \
        for (size_t i = 0; i < count && worst == OK; i++) \
            worst = set(c, references[i], kind, &values[i]); \
        return worst; \
    }

ACCESS3(Float64, double, FLOAT)
ACCESS3(Int64, int64_t, INTEGER)
ACCESS3(UInt64, uint64_t, WORD)
ACCESS3(Boolean, bool, FLAG)

EXPORT int FMI3(SetDebugLogging)(struct instance *c, bool on, size_t count, const char *const categories[])
{
    (void)on, (void)count, (void)categories;
    return c ? OK : ERROR;
}

/* what the model description does not offer: always an error */

#define NOT_OFFERED2(name) EXPORT int FMI2(name)() { return ERROR; }
#define NOT_OFFERED3(name) EXPORT int FMI3(name)() { return ERROR; }
NOT_OFFERED2(GetString) NOT_OFFERED2(SetString) NOT_OFFERED2(GetDirectionalDerivative)
NOT_OFFERED2(SetRealInputDerivatives) NOT_OFFERED2(GetRealOutputDerivatives) NOT_OFFERED2(CancelStep)
NOT_OFFERED2(GetStatus) NOT_OFFERED2(GetRealStatus) NOT_OFFERED2(GetIntegerStatus) NOT_OFFERED2(GetBooleanStatus)
NOT_OFFERED2(GetStringStatus)
EXPORT void *FMI3(InstantiateModelExchange)() { return NULL; }
EXPORT void *FMI3(InstantiateScheduledExecution)() { return NULL; }
NOT_OFFERED3(ActivateModelPartition) NOT_OFFERED3(CompletedIntegratorStep) NOT_OFFERED3(EnterConfigurationMode)
NOT_OFFERED3(EnterContinuousTimeMode) NOT_OFFERED3(EnterEventMode) NOT_OFFERED3(EnterStepMode)
NOT_OFFERED3(EvaluateDiscreteStates) NOT_OFFERED3(ExitConfigurationMode) NOT_OFFERED3(GetAdjointDerivative)
NOT_OFFERED3(GetBinary) NOT_OFFERED3(GetClock) NOT_OFFERED3(GetContinuousStateDerivatives)
NOT_OFFERED3(GetContinuousStates) NOT_OFFERED3(GetDirectionalDerivative) NOT_OFFERED3(GetEventIndicators)
NOT_OFFERED3(GetFloat32) NOT_OFFERED3(GetInt16) NOT_OFFERED3(GetInt32) NOT_OFFERED3(GetInt8)
NOT_OFFERED3(GetIntervalDecimal) NOT_OFFERED3(GetIntervalFraction) NOT_OFFERED3(GetNominalsOfContinuousStates)
NOT_OFFERED3(GetNumberOfContinuousStates) NOT_OFFERED3(GetNumberOfEventIndicators)
NOT_OFFERED3(GetNumberOfVariableDependencies) NOT_OFFERED3(GetOutputDerivatives) NOT_OFFERED3(GetShiftDecimal)
NOT_OFFERED3(GetShiftFraction) NOT_OFFERED3(GetString) NOT_OFFERED3(GetUInt16) NOT_OFFERED3(GetUInt32)
NOT_OFFERED3(GetUInt8) NOT_OFFERED3(GetVariableDependencies) NOT_OFFERED3(SetBinary) NOT_OFFERED3(SetClock)
NOT_OFFERED3(SetContinuousStates) NOT_OFFERED3(SetFloat32) NOT_OFFERED3(SetInt16) NOT_OFFERED3(SetInt32)
NOT_OFFERED3(SetInt8) NOT_OFFERED3(SetIntervalDecimal) NOT_OFFERED3(SetIntervalFraction) NOT_OFFERED3(SetShiftDecimal)
NOT_OFFERED3(SetShiftFraction) NOT_OFFERED3(SetString) NOT_OFFERED3(SetTime) NOT_OFFERED3(SetUInt16)
NOT_OFFERED3(SetUInt32) NOT_OFFERED3(SetUInt8) NOT_OFFERED3(UpdateDiscreteStates)
