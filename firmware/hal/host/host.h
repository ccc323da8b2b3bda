/* The board on a computer, for tests: chip and line are simulated, and a test moves the clock. */

#ifndef HOST_H
#define HOST_H

#include <stdbool.h>
#include <stdint.h>

/* Powers up: clock and counts zero, inputs low, nothing on the line. */
void host_reset(void);

/* Moves the clock on by `duration_us`, with a tick at each of the timer's instants on the way. */
void host_advance(uint32_t duration_us);

/* Delivers bytes from the host to the board, which handles them at once. */
void host_write(const uint8_t *bytes, unsigned count);

/* Takes at most `most` bytes that the board has sent; returns how many. */
unsigned host_read(uint8_t *bytes, unsigned most);

uint32_t host_clock_us(void);
void host_set_clock(uint32_t time_us);
uint32_t host_tick_period_us(void);

/* Moves encoder `channel`. */
void host_turn(unsigned channel, int32_t counts);

/* Sets the levels at the pins that the board does not drive. */
void host_set_inputs(uint32_t levels);

/* Pins that the board drives, and their levels. */
uint32_t host_outputs(void);
uint32_t host_levels(void);

/* PWM output as the board has set it; width 0 while it is off. */
unsigned host_width(unsigned channel);
unsigned host_prescaler(unsigned channel);
bool host_twelve_bits(unsigned channel);

/* When the board switched its outputs off last, by its clock. */
uint32_t host_off_us(void);

/* Bytes that the board can queue for the host from now on, until the host reads. */
void host_set_room(unsigned bytes);

/* Calls of the hardware layer that break its rules so far: a lock that nests, arguments out of range. */
unsigned host_faults(void);

#endif
