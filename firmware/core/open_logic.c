#include "open_logic.h"

#include "frame.h"
#include "hal.h"
#include "open_logic_tables.h"
#include "outputs.h"
#include "rtdac_usb.h"

#define KIND_AT 1u
#define LENGTH_AT 2u
#define SEQUENCE_AT 3u
#define POLLED_TICK_US 1000u /* how often the watchdog looks where the host sets no tick */
#define US_PER_MS 1000u
#define MS_PER_S 1000u

static struct {
    uint8_t state;
    uint8_t watchdog_ms;
    uint16_t tick_hz;
    uint16_t stop_pins;
    uint8_t pwm_mode;
    uint16_t pwm_prescaler;
    uint16_t challenge;
    uint16_t late;
    uint16_t bad_frames;
    uint16_t refused;
    bool ticking;             /* whether each tick sends a REPORT */
    uint32_t report;          /* number of the next REPORT */
    bool pending;             /* whether a command waits for its instant */
    uint16_t width[HAL_PWMS]; /* its widths */
    uint8_t sequence;         /* its sequence */
    uint8_t applied;          /* sequence of the command in force */
    uint32_t sample_us;       /* when the newest sample was taken */
    uint32_t counts[HAL_COUNTERS];
    uint8_t answer[OPEN_MOST_ANSWER_BYTES];
    uint8_t frame[OPEN_MOST_BYTES];
    unsigned arrived;    /* bytes of the frame that arrives; 0 outside a frame */
    uint32_t arrived_us; /* when the newest of them arrived */
} open;

static uint16_t received(struct place place)
{
    return (uint16_t)frame_get(open.frame, place);
}

/* Frames to the host. */

static void put(struct place place, uint32_t value)
{
    frame_put(open.answer, place, value);
}

static void send(uint8_t kind, unsigned size, uint8_t sequence)
{
    uint8_t *frame = open.answer;
    frame[0] = OPEN_SYNC;
    frame[KIND_AT] = kind;
    frame[LENGTH_AT] = (uint8_t)(size - OPEN_OVERHEAD_BYTES);
    frame[SEQUENCE_AT] = sequence;
    const uint16_t crc = frame_crc(&frame[KIND_AT], size - OPEN_CRC_BYTES - KIND_AT);
    frame[size - 2u] = (uint8_t)crc;
    frame[size - 1u] = (uint8_t)(crc >> 8u);
    (void)hal_send(frame, size); /* a host that does not read misses it */
}

/* Latches clock and counters. */
static void latch(void)
{
    open.sample_us = hal_clock_us();
    for (unsigned i = 0u; i < HAL_COUNTERS; i++) {
        open.counts[i] = (uint32_t)hal_count(i);
    }
}

static void send_identity(void)
{
    for (unsigned i = 0u; i < OPEN_IDENTITY_BYTES; i++) {
        open.answer[i] = open_identity[i];
    }
    uint64_t id = hal_unique_id();
    for (unsigned i = sizeof id; i > 0u; i--) {
        open.answer[OPEN_UNIQUE_ID_AT + i - 1u] = (uint8_t)id;
        id >>= 8u;
    }
    send(OPEN_IDENTITY_KIND, OPEN_IDENTITY_BYTES, open.frame[SEQUENCE_AT]);
}

static void send_status(void)
{
    latch();
    put(open_status_state, open.state);
    put(open_status_trip, outputs_reason());
    put(open_status_challenge, open.challenge);
    put(open_status_watchdog_ms, open.watchdog_ms);
    put(open_status_tick_hz, open.tick_hz);
    put(open_status_stop_pins, open.stop_pins);
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        put(open_status_width[i], outputs_width(i));
    }
    for (unsigned i = 0u; i < HAL_COUNTERS; i++) {
        put(open_status_count[i], open.counts[i]);
    }
    put(open_status_clock, open.sample_us);
    put(open_status_trips, outputs_trips());
    put(open_status_late, open.late);
    put(open_status_bad_frames, open.bad_frames);
    put(open_status_refused, open.refused);
    put(open_status_pins, hal_pins());
    put(open_status_pwm_mode, open.pwm_mode);
    put(open_status_pwm_prescaler, open.pwm_prescaler);
    send(OPEN_STATUS_KIND, OPEN_STATUS_BYTES, open.frame[SEQUENCE_AT]);
}

static void send_report(uint8_t sequence)
{
    put(open_report_tick, open.report);
    put(open_report_clock, open.sample_us);
    for (unsigned i = 0u; i < OPEN_REPORTED_COUNTERS; i++) {
        put(open_report_count[i], open.counts[i]);
    }
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        put(open_report_width[i], outputs_width(i));
    }
    put(open_report_state, open.state);
    put(open_report_trip, outputs_reason());
    put(open_report_applied, open.applied);
    put(open_report_late, open.late);
    open.report++;
    send(OPEN_REPORT_KIND, OPEN_REPORT_BYTES, sequence);
}

static void refuse(uint8_t reason)
{
    put(open_refusal_refused, open.frame[KIND_AT]);
    put(open_refusal_reason, reason);
    put(open_refusal_state, open.state);
    put(open_refusal_trip, outputs_reason());
    send(OPEN_REFUSAL_KIND, OPEN_REFUSAL_BYTES, open.frame[SEQUENCE_AT]);
}

/* States. */

static bool stop_input_low(void)
{
    return (~hal_pins() & open.stop_pins) != 0u;
}

/* Ends the tick of an arming, and its numbers. */
static void stop_tick(void)
{
    open.report = 0u;
    if (open.ticking) {
        open.ticking = false;
        hal_set_tick(POLLED_TICK_US);
    }
}

static void trip(uint8_t reason)
{
    outputs_trip(reason);
    open.state = OPEN_STATE_TRIPPED;
    open_logic_draw_challenge();
}

static void apply(const uint16_t width[HAL_PWMS])
{
    struct pwm pwm[HAL_PWMS];
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        pwm[i].width = width[i];
        pwm[i].prescaler = open.pwm_prescaler;
        pwm[i].twelve_bits = open.pwm_mode != 0u;
    }
    outputs_apply(pwm);
}

/* Frames from the host. */

static bool watchdog_and_tick_fit(uint32_t watchdog_ms, uint32_t tick_hz)
{
    if ((watchdog_ms < OPEN_WATCHDOG_MS_LEAST) || (watchdog_ms > OPEN_WATCHDOG_MS_MOST)) {
        return false;
    }
    if (tick_hz == 0u) {
        return true;
    }
    return (tick_hz >= OPEN_TICK_HZ_LEAST) && (tick_hz <= OPEN_TICK_HZ_MOST) && ((OPEN_CLOCK_HZ % tick_hz) == 0u) &&
           ((watchdog_ms * tick_hz) >= (OPEN_WATCHDOG_PERIODS * MS_PER_S));
}

static void configure(void)
{
    const uint16_t watchdog_ms = received(open_configure_watchdog_ms);
    const uint16_t tick_hz = received(open_configure_tick_hz);
    const uint16_t pwm_mode = received(open_configure_pwm_mode);
    const uint16_t off[HAL_PWMS] = {0u, 0u};
    if (open.state >= OPEN_STATE_ARMED) {
        refuse(OPEN_REFUSED_STATE);
    } else if (!watchdog_and_tick_fit(watchdog_ms, tick_hz) || (pwm_mode >= OPEN_MODES)) {
        refuse(OPEN_REFUSED_VALUE);
    } else if (outputs_on()) {
        refuse(OPEN_REFUSED_OUTPUTS);
    } else {
        open.watchdog_ms = (uint8_t)watchdog_ms;
        open.tick_hz = tick_hz;
        open.stop_pins = received(open_configure_stop_pins);
        open.pwm_mode = (uint8_t)pwm_mode;
        open.pwm_prescaler = received(open_configure_pwm_prescaler);
        open.state = OPEN_STATE_CONFIGURED;
        rtdac_usb_reset();
        apply(off);
        send_status();
    }
}

static void arm(void)
{
    if (open.state != OPEN_STATE_CONFIGURED) {
        refuse(OPEN_REFUSED_STATE);
    } else if (received(open_arm_answer) != (open.challenge ^ OPEN_CHALLENGE_MASK)) {
        refuse(OPEN_REFUSED_ANSWER);
    } else if (stop_input_low()) {
        refuse(OPEN_REFUSED_STOP_INPUT);
    } else if (outputs_on()) {
        refuse(OPEN_REFUSED_OUTPUTS);
    } else {
        open.state = OPEN_STATE_ARMED;
        open.report = 0u;
        open.applied = 0u;
        open.pending = false;
        open_logic_draw_challenge();
        outputs_feed(open.watchdog_ms * US_PER_MS);
        if (open.tick_hz != 0u) {
            open.ticking = true;
            hal_set_tick(OPEN_CLOCK_HZ / open.tick_hz);
        }
        send_status();
    }
}

/* Whether the command that has arrived answers the newest REPORT. */
static bool in_time(void)
{
    return (open.report != 0u) && (open.frame[SEQUENCE_AT] == (uint8_t)(open.report - 1u));
}

static void command(void)
{
    const uint16_t width[HAL_PWMS] = {received(open_command_width[0]), received(open_command_width[1])};
    const uint16_t steps = open_steps[open.pwm_mode];
    const bool fits = (width[0] <= steps) && (width[1] <= steps);
    const uint8_t sequence = open.frame[SEQUENCE_AT];
    if (open.state != OPEN_STATE_ARMED) {
        if ((width[0] != 0u) || (width[1] != 0u)) {
            open.refused++;
        }
    } else if (!fits || (open.ticking && !in_time())) {
        open.refused++;
    } else {
        outputs_feed(open.watchdog_ms * US_PER_MS);
        if (open.ticking) {
            open.pending = true;
            open.width[0] = width[0];
            open.width[1] = width[1];
            open.sequence = sequence;
        } else {
            apply(width);
            open.applied = sequence;
        }
    }
    if (!open.ticking) {
        latch();
        send_report(sequence);
    }
}

static void disarm(void)
{
    outputs_off();
    rtdac_usb_show_off();
    stop_tick();
    open_logic_draw_challenge();
    if (open.state == OPEN_STATE_ARMED) {
        open.state = OPEN_STATE_CONFIGURED;
    }
    send_status();
}

static void clear(void)
{
    if (open.state == OPEN_STATE_ARMED) {
        refuse(OPEN_REFUSED_STATE);
    } else if ((open.state == OPEN_STATE_TRIPPED) && stop_input_low()) {
        refuse(OPEN_REFUSED_STOP_INPUT);
    } else {
        if (open.state == OPEN_STATE_TRIPPED) {
            open.state = OPEN_STATE_CONFIGURED;
            stop_tick();
        }
        send_status();
    }
}

static void act(void)
{
    switch (open.frame[KIND_AT]) {
    case OPEN_HELLO_KIND:
        send_identity();
        break;
    case OPEN_CONFIGURE_KIND:
        configure();
        break;
    case OPEN_ARM_KIND:
        arm();
        break;
    case OPEN_COMMAND_KIND:
        command();
        break;
    case OPEN_DISARM_KIND:
        disarm();
        break;
    case OPEN_CLEAR_KIND:
        clear();
        break;
    default: /* QUERY: the parser lets no other kind through */
        send_status();
        break;
    }
}

/* Length of the frame whose kind has arrived; 0 if there is no such kind. */
static unsigned expected_bytes(void)
{
    const uint8_t kind = open.frame[KIND_AT];
    return (kind < sizeof open_bytes) ? open_bytes[kind] : 0u;
}

static void drop(void)
{
    open.arrived = 0u;
    open.bad_frames++;
}

/* Whether kind and length, as far as they have arrived, are those of a frame. */
static bool plausible(void)
{
    const unsigned size = expected_bytes();
    return (size != 0u) && ((open.arrived <= LENGTH_AT) || (open.frame[LENGTH_AT] == (size - OPEN_OVERHEAD_BYTES)));
}

/* Acts upon a frame that has arrived whole. */
static void finish(void)
{
    const unsigned body = open.arrived - OPEN_CRC_BYTES;
    const unsigned crc = open.frame[body] | ((unsigned)open.frame[body + 1u] << 8u);
    if (crc == frame_crc(&open.frame[KIND_AT], body - KIND_AT)) {
        open.arrived = 0u;
        act();
    } else {
        drop();
    }
}

void open_logic_reset(void)
{
    open.state = OPEN_STATE_IDLE;
    open.watchdog_ms = 0u;
    open.tick_hz = 0u;
    open.stop_pins = 0u;
    open.pwm_mode = 0u;
    open.pwm_prescaler = 0u;
    open.late = 0u;
    open.bad_frames = 0u;
    open.refused = 0u;
    open.ticking = false;
    open.report = 0u;
    open.applied = 0u;
    open.arrived = 0u;
    open_logic_draw_challenge();
    hal_set_tick(POLLED_TICK_US);
}

bool open_logic_take(uint8_t byte)
{
    const uint32_t now_us = hal_clock_us();
    const bool silent = (now_us - open.arrived_us) >= OPEN_SILENCE_US;
    open.arrived_us = now_us;
    if ((open.arrived != 0u) && silent) {
        drop();
    }
    if (open.arrived != 0u) {
        open.frame[open.arrived] = byte;
        open.arrived++;
        if (plausible()) {
            if (open.arrived == expected_bytes()) {
                finish();
            }
            return true;
        }
        drop();
    }
    /* the byte is outside a frame */
    open.arrived = (byte == OPEN_SYNC) ? 1u : 0u;
    return open.arrived != 0u;
}

/* Watchdog and stop inputs, while armed. */
static void look_after_outputs(void)
{
    if (stop_input_low()) {
        trip(OPEN_TRIP_STOP_INPUT);
    } else if (outputs_expired()) {
        trip(OPEN_TRIP_WATCHDOG);
    } else {
        /* all is well */
    }
}

/* Puts the command of this instant in force. */
static void take_command(void)
{
    if (open.pending) {
        open.pending = false;
        apply(open.width);
        open.applied = open.sequence;
    } else if (open.report != 0u) {
        open.late++;
    } else {
        /* no command answers a REPORT before the first */
    }
}

void open_logic_tick(void)
{
    if (open.ticking) {
        latch();
    }
    if (open.state == OPEN_STATE_ARMED) {
        look_after_outputs();
    }
    if (open.ticking) {
        if (open.state == OPEN_STATE_ARMED) {
            take_command();
        }
        send_report((uint8_t)open.report);
    }
}

bool open_logic_armed(void)
{
    return open.state == OPEN_STATE_ARMED;
}

bool open_logic_tripped(void)
{
    return open.state == OPEN_STATE_TRIPPED;
}

void open_logic_draw_challenge(void)
{
    /* an odd step leads to another number */
    open.challenge = (uint16_t)(open.challenge + ((hal_clock_us() << 1u) | 1u));
}
