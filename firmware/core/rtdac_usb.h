/* The vendor's logic 0x0111: frames of a first-generation RT-DAC/USB (firmware_protocol/PROTOCOL.md).

   Programs of that board know no arming and no watchdog: the outputs go off RTDAC_USB_WATCHDOG_US after the last SEND
   frame, and stay off until a SEND frame has all widths zero. Analogue inputs and outputs, the generator, index inputs
   and PWM 2 and 3 are echoed, and do nothing. */

#ifndef RTDAC_USB_H
#define RTDAC_USB_H

#include <stdbool.h>
#include <stdint.h>

/* Settings as after power-up: all zero, all pins inputs. The outputs stay as they are. */
void rtdac_usb_reset(void);

/* Takes a byte of the line. A SEND frame changes nothing unless it `may_set`. */
void rtdac_usb_take(uint8_t byte, bool may_set);

/* Drops an unfinished SEND frame. */
void rtdac_usb_drop(void);

/* The watchdog of this logic, for each tick in which it has the outputs. Returns whether it trips. */
bool rtdac_usb_tick(void);

/* Shows both widths as zero: something else has switched the outputs off. */
void rtdac_usb_show_off(void);

#endif
