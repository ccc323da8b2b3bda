/* The line to the host: a USB serial port (CDC ACM, full speed), which Linux, macOS and Windows need no driver for. */

#ifndef USB_H
#define USB_H

#include <stdint.h>

/* Attaches to the bus; `serial` is what tells two boards apart. Call it with interrupts masked. */
void usb_start(uint64_t serial);

/* Call it from the interrupt of the USB controller. */
void usb_interrupt(void);

/* Asks for the interrupt if bytes of the host can be taken again: call it after the queue of received bytes was read. */
void usb_resume(void);

#endif
