/* The open board. A chip's hardware layer (hal/hal.h) calls these functions. */

#ifndef BOARD_H
#define BOARD_H

/* State after power-up: outputs off, pins inputs, counters free, tick of 1 ms. Call it once, before all others. */
void board_reset(void);

/* One tick: call it from the timer's interrupt, at the period of hal_set_tick. */
void board_tick(void);

/* Handles all bytes that have arrived: call it from the main loop, again and again. */
void board_poll(void);

#endif
