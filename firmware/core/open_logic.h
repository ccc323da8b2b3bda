/* The open board's own logic (firmware_protocol/PROTOCOL.md): frames with a CRC, arming, a watchdog whose time the host
   sets, and a tick. */

#ifndef OPEN_LOGIC_H
#define OPEN_LOGIC_H

#include <stdbool.h>
#include <stdint.h>

/* State idle, as after power-up. */
void open_logic_reset(void);

/* Takes a byte of the line. Returns whether it belongs to a frame. */
bool open_logic_take(uint8_t byte);

/* One tick: sample, watchdog, stop inputs, the command of this instant, and REPORT. */
void open_logic_tick(void);

/* Whether the outputs are this logic's. */
bool open_logic_armed(void);

/* Whether the outputs stay off until the host clears the trip. */
bool open_logic_tripped(void);

/* Draws another challenge for ARM. */
void open_logic_draw_challenge(void);

#endif
