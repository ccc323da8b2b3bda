/* The two PWM outputs, the watchdog's time, and the record of trips. Which logic may use them is theirs to know.

   Call all functions with the tick locked out, or from it. */

#ifndef OUTPUTS_H
#define OUTPUTS_H

#include <stdbool.h>
#include <stdint.h>

#include "hal.h"

/* One output, as hal_pwm takes it. */
struct pwm {
    uint16_t width;
    uint16_t prescaler;
    bool twelve_bits;
};

/* State after power-up: off, no trip. */
void outputs_reset(void);

/* Applies both outputs. */
void outputs_apply(const struct pwm pwm[HAL_PWMS]);

/* Switches both outputs off. */
void outputs_off(void);

/* Whether a width is not zero. */
bool outputs_on(void);

/* Width in force of a channel. */
uint16_t outputs_width(unsigned channel);

/* The watchdog: outputs_expired is true from `watchdog_us` after the newest feeding on. */
void outputs_feed(uint32_t watchdog_us);
bool outputs_expired(void);

/* Switches both outputs off and records why. */
void outputs_trip(uint8_t reason);
uint8_t outputs_reason(void);
uint16_t outputs_trips(void);

#endif
