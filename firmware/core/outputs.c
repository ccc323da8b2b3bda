#include "outputs.h"

static struct {
    uint16_t width[HAL_PWMS];
    uint8_t reason;
    uint16_t trips;
    uint32_t fed_us;
    uint32_t watchdog_us;
} outputs;

void outputs_reset(void)
{
    outputs_off();
    outputs.reason = 0u;
    outputs.trips = 0u;
}

void outputs_apply(const struct pwm pwm[HAL_PWMS])
{
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        hal_pwm(i, pwm[i].width, pwm[i].twelve_bits, pwm[i].prescaler);
        outputs.width[i] = pwm[i].width;
    }
}

void outputs_off(void)
{
    hal_outputs_off();
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        outputs.width[i] = 0u;
    }
}

bool outputs_on(void)
{
    return (outputs.width[0] != 0u) || (outputs.width[1] != 0u);
}

uint16_t outputs_width(unsigned channel)
{
    return outputs.width[channel];
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
    outputs.reason = reason;
    outputs.trips++;
}

uint8_t outputs_reason(void)
{
    return outputs.reason;
}

uint16_t outputs_trips(void)
{
    return outputs.trips;
}
