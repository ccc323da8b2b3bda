/* The two PWM outputs and what switches them off: watchdog and fault latch.

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

/* State after power-up: off, latch clear. */
void outputs_reset(void);

/* Applies both outputs. Returns false, and changes nothing, if the latch is set and a width is not zero. */
bool outputs_apply(const struct pwm pwm[HAL_PWMS]);

/* Switches both outputs off, at once. */
void outputs_off(void);

/* Whether a width is not zero. */
bool outputs_on(void);

/* The watchdog: outputs_expired is true from `watchdog_us` after the last feeding on. */
void outputs_feed(uint32_t watchdog_us);
bool outputs_expired(void);

/* The fault latch: outputs_trip switches off and keeps off, until outputs_clear. */
void outputs_trip(uint8_t reason);
void outputs_clear(void);
bool outputs_tripped(void);

#endif
