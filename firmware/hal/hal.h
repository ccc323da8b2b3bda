/* What the core asks of a chip. A hardware layer defines these functions, calls board_reset once, board_poll in its
   main loop and board_tick from its timer's interrupt (board.h).

   The core calls hal_receive outside a lock, and all others either from board_reset, from board_tick, or between
   hal_lock and hal_unlock, which never nest: so none of them is entered twice. */

#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stdint.h>

#define HAL_COUNTERS 4u       /* quadrature counters */
#define HAL_PWMS 2u           /* PWM outputs */
#define HAL_PINS 26u          /* digital pins of connector CN1 */
#define HAL_SEND_BYTES 150u   /* most bytes of one hal_send */

/* Microseconds since power-up; wraps after 71 minutes. */
uint32_t hal_clock_us(void);

/* Calls board_tick every `period_us` microseconds, 250 to 10 000; for the first time one period from now. */
void hal_set_tick(uint32_t period_us);

/* Count of a quadrature encoder, 0 to 3: all four edges, two's complement, wraps at 32 bits. The core reads the clock
   and then the counters, one after the other. */
int32_t hal_count(unsigned channel);

/* Holds a counter at zero, or lets it count from zero on; without effect if it already is so. */
void hal_hold_counter(unsigned channel, bool at_zero);

/* Sets PWM output 0 or 1: high for `width` parts of 255 (`twelve_bits` false) or of 4095 of its period, whose frequency
   is 40 MHz / ((prescaler + 1) * parts), or the nearest that the chip has. Width 0 is low all the time. */
void hal_pwm(unsigned channel, uint16_t width, bool twelve_bits, uint16_t prescaler);

/* Makes every PWM output low at once, until the next hal_pwm. Callable from every context,
   a fault handler included. */
void hal_outputs_off(void);

/* Levels of the digital pins, bit i of pin i: 1 = high. Outputs read as they are driven. */
uint32_t hal_pins(void);

/* Drives the pins in `outputs` to the levels in `value`; all others are inputs. */
void hal_set_pins(uint32_t value, uint32_t outputs);

/* Number of the chip; 0 where it has none. */
uint64_t hal_unique_id(void);

/* The oldest byte that arrived from the host, 0 to 255; -1 if there is none. */
int hal_receive(void);

/* Queues all `count` bytes for the host, at most HAL_SEND_BYTES, or none: false if they do not fit. Does not wait. */
bool hal_send(const uint8_t *bytes, unsigned count);

/* Keep board_tick out, and let it in again. */
void hal_lock(void);
void hal_unlock(void);

#endif
