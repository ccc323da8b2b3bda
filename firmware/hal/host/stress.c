/* Damaged bytes at the board: `stress BYTES SEED` delivers so many, and prints what happened, or the
   first wrong output, with exit code 1.

   Messages of both logics are made as a host makes them, and damaged: bits, bytes, order, length. Between any two bytes
   time may pass. After each byte and each tick the outputs are audited from outside: this program looks for whole frames
   anywhere in the bytes that it delivered, so that it shares no rule of framing with the board. An output may be on only

   - with the widths of a COMMAND with a right CRC, at most one watchdog time and one tick old, after an ARM that answered
     the board's newest challenge, and while no answer has shown another state than armed; or
   - with the widths of a SEND frame of logic 0x0111, at most 250 ms and one tick old.

   All that the board sends must be whole frames. After silence it must answer QUERY and DISARM, and be off after the
   latter. */

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

#define SYNC 0xA5u
#define VENDOR_BYTES 150u
#define VENDOR_WATCHDOG_US 250000u
#define LONGEST 160u
#define KEPT 256u

enum kind { HELLO = 1, CONFIGURE, ARM, COMMAND, DISARM, QUERY, CLEAR };
static const unsigned payload_of[] = {0u, 0u, 8u, 2u, 4u, 0u, 0u, 0u};

/* What may have set the outputs. */
struct cause {
    unsigned width[2];
    uint32_t time_us;
    bool vendor;
    bool valid;
};

static struct {
    uint64_t random;
    unsigned long delivered;
    unsigned long most;
    uint8_t tail[LONGEST]; /* newest bytes delivered, the newest last */
    struct cause causes[KEPT];
    unsigned next_cause;
    bool may_be_armed;
    unsigned state;
    uint16_t challenge;
    unsigned watchdog_ms;
    uint8_t report; /* sequence of the newest REPORT */
    uint8_t answers[4096];
    unsigned answer_bytes;
    unsigned long statuses;
    unsigned long open_on;
    unsigned long vendor_on;
    unsigned long trips;
    unsigned long damaged;
} run;

static uint32_t drawn(uint32_t below)
{
    run.random ^= run.random << 13;
    run.random ^= run.random >> 7;
    run.random ^= run.random << 17;
    return (uint32_t)(run.random >> 32) % below;
}

static void fail(const char *what)
{
    fprintf(stderr, "byte %lu, clock %lu us: %s\n", run.delivered, (unsigned long)host_clock_us(), what);
    exit(1);
}

static unsigned u16(const uint8_t *bytes)
{
    return bytes[0] | ((unsigned)bytes[1] << 8);
}

static unsigned crc_of(const uint8_t *bytes, unsigned count)
{
    unsigned crc = 0xFFFFu;
    for (unsigned i = 0; i < count; i++) {
        unsigned x = ((crc >> 8) ^ bytes[i]) & 0xFFu;
        x ^= x >> 4;
        crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 0xFFFFu;
    }
    return crc;
}

static bool whole(const uint8_t *frame, unsigned size)
{
    return frame[0] == SYNC && frame[2] == size - 6u && crc_of(frame + 1, size - 3u) == u16(frame + size - 2u);
}

/* The audit. */

static void add_cause(unsigned width0, unsigned width1, bool vendor)
{
    const struct cause cause = {{width0, width1}, host_clock_us(), vendor, true};
    run.causes[run.next_cause] = cause;
    run.next_cause = (run.next_cause + 1u) % KEPT;
}

/* Width of a channel in a SEND frame of logic 0x0111. */
static unsigned vendor_width(const uint8_t *frame, unsigned channel)
{
    const uint8_t *data = frame + 1u + 21u + 5u * channel;
    const unsigned width = data[3] | ((unsigned)(data[4] & 0x1Fu) << 7);
    const bool connected = ((frame[9] >> channel) & 1u) != 0u;
    return !connected ? 0u : (data[2] & 0x40u) != 0u ? width : width & 0xFFu;
}

static void note_delivered(uint8_t byte)
{
    memmove(run.tail, run.tail + 1, LONGEST - 1u);
    run.tail[LONGEST - 1u] = byte;
    const uint8_t *end = run.tail + LONGEST;
    const uint8_t *command = end - (6u + payload_of[COMMAND]);
    if (command[1] == COMMAND && whole(command, 6u + payload_of[COMMAND])) {
        add_cause(u16(command + 4), u16(command + 6), false);
    }
    const uint8_t *configure = end - (6u + payload_of[CONFIGURE]);
    if (configure[1] == CONFIGURE && whole(configure, 6u + payload_of[CONFIGURE]) && configure[4] > run.watchdog_ms) {
        run.watchdog_ms = configure[4]; /* until a STATUS shows the one in force */
    }
    const uint8_t *arm = end - (6u + payload_of[ARM]);
    if (arm[1] == ARM && whole(arm, 6u + payload_of[ARM]) && u16(arm + 4) == (run.challenge ^ 0x5AC3u)) {
        run.may_be_armed = true;
    }
    const uint8_t *vendor = end - VENDOR_BYTES;
    bool all = vendor[0] == 0x81u;
    for (unsigned i = 1u; all && i < VENDOR_BYTES; i++) {
        all = vendor[i] < 0x80u;
    }
    if (all) {
        add_cause(vendor_width(vendor, 0u), vendor_width(vendor, 1u), true);
    }
}

static void note_state(unsigned state)
{
    run.may_be_armed = run.may_be_armed && state == 2u;
    run.trips += state == 3u && run.state != 3u;
    run.state = state;
}

static void note_answer(const uint8_t *frame, unsigned size)
{
    if (!whole(frame, size)) {
        fail("an answer is damaged");
    }
    switch (frame[1]) {
    case 0x83:
        run.statuses++;
        run.challenge = (uint16_t)u16(frame + 6);
        run.watchdog_ms = frame[8];
        note_state(frame[4]);
        break;
    case 0x84:
        run.report = frame[3];
        note_state(frame[24]);
        break;
    case 0x8F:
        note_state(frame[6]);
        break;
    default:
        break;
    }
}

static void note_answers(void)
{
    run.answer_bytes = host_read(run.answers, sizeof run.answers);
    for (unsigned at = 0u; at < run.answer_bytes;) {
        const uint8_t *frame = run.answers + at;
        const unsigned left = run.answer_bytes - at;
        unsigned size = VENDOR_BYTES;
        if (frame[0] == SYNC) {
            size = left < 3u ? 6u : frame[2] + 6u;
            if (size > left) {
                fail("an answer is cut");
            }
            note_answer(frame, size);
        } else if (left < VENDOR_BYTES || u16(frame) != 0x0111u) {
            fail("an answer is of no logic");
        }
        at += size;
    }
}

static void audit(void)
{
    note_answers();
    const unsigned width[2] = {host_width(0u), host_width(1u)};
    if (host_faults() != 0u) {
        fail("the core breaks a rule of hal.h");
    }
    if (width[0] == 0u && width[1] == 0u) {
        return;
    }
    const uint32_t tick_us = host_tick_period_us();
    for (unsigned i = 0u; i < KEPT; i++) {
        const struct cause *cause = &run.causes[i];
        const uint32_t longest_us = tick_us + (cause->vendor ? VENDOR_WATCHDOG_US : run.watchdog_ms * 1000u);
        const uint32_t age_us = host_clock_us() - cause->time_us;
        if (cause->valid && cause->width[0] == width[0] && cause->width[1] == width[1] && age_us < longest_us &&
            (cause->vendor || run.may_be_armed)) {
            run.vendor_on += cause->vendor;
            run.open_on += !cause->vendor;
            return;
        }
    }
    fail("an output is on without a cause");
}

/* The host, and what damages its bytes. */

static void pass(uint32_t duration_us)
{
    for (uint32_t left = duration_us; left > 0u;) {
        const uint32_t tick_us = host_tick_period_us();
        const uint32_t step = left < tick_us ? left : tick_us;
        host_advance(step);
        audit();
        left -= step;
    }
}

static void deliver(const uint8_t *bytes, unsigned count)
{
    for (unsigned i = 0u; i < count; i++) {
        if (drawn(64u) == 0u) {
            pass(drawn(2500u));
        }
        note_delivered(bytes[i]);
        host_write(bytes + i, 1u);
        run.delivered++;
        audit();
    }
}

static unsigned sealed(uint8_t *frame, enum kind kind, uint8_t sequence)
{
    const unsigned size = 6u + payload_of[kind];
    frame[0] = SYNC;
    frame[1] = (uint8_t)kind;
    frame[2] = (uint8_t)payload_of[kind];
    frame[3] = sequence;
    const unsigned crc = crc_of(frame + 1, size - 3u);
    frame[size - 2u] = (uint8_t)crc;
    frame[size - 1u] = (uint8_t)(crc >> 8);
    return size;
}

static void put16(uint8_t *bytes, unsigned value)
{
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
}

static unsigned message(uint8_t *bytes)
{
    static const uint16_t rates[] = {0u, 0u, 100u, 500u, 1000u, 2000u, 4000u, 333u, 5000u};
    static const enum kind kinds[] = {CONFIGURE, ARM, ARM, COMMAND, COMMAND, COMMAND, HELLO, DISARM, QUERY, CLEAR};
    uint8_t *payload = bytes + 4;
    if (drawn(16u) == 0u) {
        if (drawn(3u) == 0u) {
            bytes[0] = (uint8_t)(0x80u + drawn(4u));
            return 1u;
        }
        bytes[0] = 0x81u;
        for (unsigned i = 1u; i < VENDOR_BYTES; i++) {
            bytes[i] = (uint8_t)(drawn(2u) * drawn(0x80u));
        }
        if (drawn(3u) == 0u) {
            memset(bytes + 1, 0, VENDOR_BYTES - 1u);
        }
        return VENDOR_BYTES;
    }
    const enum kind kind = kinds[drawn(sizeof kinds / sizeof kinds[0])];
    uint8_t sequence = (uint8_t)drawn(256u);
    if (kind == CONFIGURE) {
        payload[0] = (uint8_t)(drawn(8u) == 0u ? drawn(256u) : 2u + drawn(99u));
        put16(payload + 1, rates[drawn(sizeof rates / sizeof rates[0])]);
        put16(payload + 3, drawn(4u) == 0u ? drawn(65536u) : 0u);
        payload[5] = (uint8_t)drawn(drawn(8u) == 0u ? 256u : 2u);
        put16(payload + 6, drawn(65536u));
    } else if (kind == ARM) {
        put16(payload, drawn(8u) == 0u ? drawn(65536u) : run.challenge ^ 0x5AC3u);
    } else if (kind == COMMAND) {
        put16(payload, drawn(drawn(8u) == 0u ? 65536u : 256u));
        put16(payload + 2, drawn(drawn(4u) == 0u ? 4096u : 256u));
        sequence = drawn(4u) == 0u ? sequence : run.report;
    }
    return sealed(bytes, kind, sequence);
}

static unsigned damage(uint8_t *bytes, unsigned size)
{
    const unsigned at = drawn(size);
    switch (drawn(6u)) {
    case 0u: /* a bit */
        bytes[at] ^= (uint8_t)(1u << drawn(8u));
        return size;
    case 1u: /* a byte */
        bytes[at] = (uint8_t)drawn(256u);
        return size;
    case 2u: /* a byte is lost */
        memmove(bytes + at, bytes + at + 1u, size - at - 1u);
        return size - 1u;
    case 3u: /* one comes twice */
        memmove(bytes + at + 1u, bytes + at, size - at);
        return size + 1u;
    case 4u: /* the end is missing */
        return at;
    default: /* another content with a right CRC */
        if (bytes[0] == SYNC && size > 6u) {
            bytes[4u + drawn(size - 6u)] = (uint8_t)drawn(256u);
            put16(bytes + size - 2u, crc_of(bytes + 1, size - 3u));
        }
        return size;
    }
}

/* Sends an undamaged frame after silence, in which the board has dropped all that came before. */
static void send_after_silence(enum kind kind)
{
    uint8_t frame[LONGEST];
    pass(2000u);
    const unsigned size = sealed(frame, kind, 1u);
    for (unsigned i = 0u; i < size; i++) {
        note_delivered(frame[i]);
    }
    host_set_room(65536u);
    const unsigned long before = run.statuses;
    host_write(frame, size);
    audit();
    if (run.statuses != before + 1u) {
        fail("after silence a frame has no answer");
    }
    if (kind == DISARM && (host_width(0u) | host_width(1u)) != 0u) {
        fail("an output is on after DISARM");
    }
}

static void step(void)
{
    uint8_t bytes[2u * LONGEST];
    switch (drawn(12u)) {
    case 0u:
        pass(drawn(drawn(8u) == 0u ? 300000u : 5000u));
        break;
    case 1u:
        host_set_inputs(drawn(2u) == 0u ? 0xFFFFu : drawn(65536u));
        host_turn(drawn(4u), (int32_t)drawn(1000u) - 500);
        break;
    case 2u:
        host_set_room(drawn(4u) == 0u ? drawn(200u) : 65536u);
        break;
    case 3u:
        send_after_silence(drawn(4u) == 0u ? DISARM : QUERY);
        break;
    case 4u:
        for (unsigned i = 0u; i < 32u; i++) {
            bytes[i] = (uint8_t)drawn(256u);
        }
        deliver(bytes, drawn(33u));
        break;
    default: {
        unsigned size = message(bytes);
        for (unsigned i = drawn(4u); i < 2u && size > 0u; i++) {
            size = damage(bytes, size);
            run.damaged++;
        }
        deliver(bytes, size);
        break;
    }
    }
}

int main(int count, char **words)
{
    if (count != 3) {
        fprintf(stderr, "usage: stress BYTES SEED\n");
        return 2;
    }
    run.most = strtoul(words[1], NULL, 10);
    run.random = (strtoul(words[2], NULL, 10) + 1u) * 0x9E3779B97F4A7C15u;
    host_reset();
    while (run.delivered < run.most) {
        step();
    }
    printf("{\"bytes\": %lu, \"damaged messages\": %lu, \"statuses\": %lu, \"trips\": %lu, ", run.delivered, run.damaged,
           run.statuses, run.trips);
    printf("\"on by the open logic\": %lu, \"on by the vendor's\": %lu}\n", run.open_on, run.vendor_on);
    return 0;
}
