#include "outputs.h"

static struct {
    bool on;
    bool tripped;
    uint8_t reason;
    uint16_t trips;
    uint32_t fed_us;
    uint32_t watchdog_us;
} outputs;

void outputs_reset(void)
{
    outputs_off();
    outputs.tripped = false;
    outputs.reason = 0u;
    outputs.trips = 0u;
    outputs_feed(0u);
}

bool outputs_apply(const struct pwm pwm[HAL_PWMS])
{
    bool on = false;
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        on = on || (pwm[i].width != 0u);
    }
    if (on && outputs.tripped) {
        return false;
    }
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        hal_pwm(i, pwm[i].width, pwm[i].twelve_bits, pwm[i].prescaler);
    }
    outputs.on = on;
    return true;
}

void outputs_off(void)
{
    hal_outputs_off();
    outputs.on = false;
}

bool outputs_on(void)
{
    return outputs.on;
}

void outputs_feed(uint32_t watchdog_us)
{
    outputs.watchdog_us = watchdog_us;
    outputs.fed_us = hal_clock_us();
}

bool outputs_expired(void)
{
    /* the difference is right across the clock's wrap */
    return (hal_clock_us() - outputs.fed_us) >= outputs.watchdog_us;
}

void outputs_trip(uint8_t reason)
{
    outputs_off();
    outputs.tripped = true;
    outputs.reason = reason;
    outputs.trips++;
}

void outputs_clear(void)
{
    outputs.tripped = false;
}

bool outputs_tripped(void)
{
    return outputs.tripped;
}
