#include "host.h"

#include <string.h>

#include "board.h"
#include "hal.h"

#define ROOM 65536u
#define FULL_WIDTH 4095u
#define UNIQUE_ID 0x0123456789ABCDEFu

static struct {
    uint32_t clock_us;
    uint32_t tick_us;
    uint32_t next_tick_us;
    uint32_t counts[HAL_COUNTERS];
    bool held[HAL_COUNTERS];
    unsigned width[HAL_PWMS];
    unsigned prescaler[HAL_PWMS];
    bool twelve_bits[HAL_PWMS];
    uint32_t off_us;
    uint32_t inputs;
    uint32_t levels;
    uint32_t outputs;
    const uint8_t *arriving;
    unsigned left;
    uint8_t sent[ROOM];
    unsigned sent_bytes;
    unsigned room;
    bool locked;
    bool in_tick;
    unsigned faults;
} host;

static void require(bool condition)
{
    if (!condition) {
        host.faults++;
    }
}

/* The core calls most functions with the tick locked out, or from it. */
static void require_exclusive(void)
{
    require(host.locked != host.in_tick);
}

void host_reset(void)
{
    memset(&host, 0, sizeof host);
    host.room = ROOM;
    host.locked = true; /* board_reset comes before the first tick */
    board_reset();
    host.locked = false;
}

void host_advance(uint32_t duration_us)
{
    uint32_t left = duration_us;
    while ((host.next_tick_us - host.clock_us) <= left) {
        left -= host.next_tick_us - host.clock_us;
        host.clock_us = host.next_tick_us;
        host.next_tick_us += host.tick_us;
        host.in_tick = true;
        board_tick();
        host.in_tick = false;
    }
    host.clock_us += left;
}

void host_write(const uint8_t *bytes, unsigned count)
{
    host.arriving = bytes;
    host.left = count;
    board_poll();
}

unsigned host_read(uint8_t *bytes, unsigned most)
{
    const unsigned count = (host.sent_bytes < most) ? host.sent_bytes : most;
    memcpy(bytes, host.sent, count);
    memmove(host.sent, host.sent + count, host.sent_bytes - count);
    host.sent_bytes -= count;
    return count;
}

uint32_t host_clock_us(void)
{
    return host.clock_us;
}

void host_set_clock(uint32_t time_us)
{
    host.next_tick_us += time_us - host.clock_us;
    host.clock_us = time_us;
}

uint32_t host_tick_period_us(void)
{
    return host.tick_us;
}

void host_turn(unsigned channel, int32_t counts)
{
    if (!host.held[channel]) {
        host.counts[channel] += (uint32_t)counts;
    }
}

void host_set_inputs(uint32_t levels)
{
    host.inputs = levels;
}

uint32_t host_outputs(void)
{
    return host.outputs;
}

uint32_t host_levels(void)
{
    return host.levels;
}

unsigned host_width(unsigned channel)
{
    return host.width[channel];
}

unsigned host_prescaler(unsigned channel)
{
    return host.prescaler[channel];
}

bool host_twelve_bits(unsigned channel)
{
    return host.twelve_bits[channel];
}

uint32_t host_off_us(void)
{
    return host.off_us;
}

void host_set_room(unsigned bytes)
{
    host.room = (bytes < ROOM) ? bytes : ROOM;
}

unsigned host_faults(void)
{
    return host.faults;
}

/* The hardware layer. */

uint32_t hal_clock_us(void)
{
    require_exclusive();
    return host.clock_us;
}

void hal_set_tick(uint32_t period_us)
{
    require_exclusive();
    require((period_us >= 250u) && (period_us <= 10000u));
    host.tick_us = period_us;
    host.next_tick_us = host.clock_us + period_us;
}

int32_t hal_count(unsigned channel)
{
    require_exclusive();
    require(channel < HAL_COUNTERS);
    return (int32_t)host.counts[channel];
}

void hal_hold_counter(unsigned channel, bool at_zero)
{
    require_exclusive();
    require(channel < HAL_COUNTERS);
    host.held[channel] = at_zero;
    if (at_zero) {
        host.counts[channel] = 0u;
    }
}

void hal_pwm(unsigned channel, uint16_t width, bool twelve_bits, uint16_t prescaler)
{
    require_exclusive();
    require(channel < HAL_PWMS);
    require(width <= (twelve_bits ? FULL_WIDTH : 255u));
    host.width[channel] = width;
    host.twelve_bits[channel] = twelve_bits;
    host.prescaler[channel] = prescaler;
}

void hal_outputs_off(void)
{
    host.off_us = host.clock_us;
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        host.width[i] = 0u;
    }
}

uint32_t hal_pins(void)
{
    require_exclusive();
    return (host.levels & host.outputs) | (host.inputs & ~host.outputs & ((1u << HAL_PINS) - 1u));
}

void hal_set_pins(uint32_t value, uint32_t outputs)
{
    require_exclusive();
    require((outputs >> HAL_PINS) == 0u);
    host.levels = value & outputs;
    host.outputs = outputs;
}

uint64_t hal_unique_id(void)
{
    return UNIQUE_ID;
}

int hal_receive(void)
{
    require(!host.locked && !host.in_tick);
    if (host.left == 0u) {
        return -1;
    }
    host.left--;
    return *host.arriving++;
}

bool hal_send(const uint8_t *bytes, unsigned count)
{
    require_exclusive();
    require((count > 0u) && (count <= HAL_SEND_BYTES));
    if (count > (host.room - ((host.sent_bytes < host.room) ? host.sent_bytes : host.room))) {
        return false;
    }
    memcpy(host.sent + host.sent_bytes, bytes, count);
    host.sent_bytes += count;
    return true;
}

void hal_lock(void)
{
    require(!host.locked && !host.in_tick);
    host.locked = true;
}

void hal_unlock(void)
{
    require(host.locked);
    host.locked = false;
}
