#include "board.h"

#include "hal.h"
#include "open_logic.h"
#include "outputs.h"
#include "rtdac_usb.h"

void board_reset(void)
{
    outputs_reset();
    rtdac_usb_reset();
    open_logic_reset();
}

void board_tick(void)
{
    if (!open_logic_armed() && rtdac_usb_tick()) {
        open_logic_draw_challenge();
    }
    open_logic_tick();
}

/* Bytes outside a frame of the open logic are the vendor's, unless the open logic has the outputs: there they are
   damage, and a damaged byte must not start an answer of 150 bytes. */
static void take(uint8_t byte)
{
    if (open_logic_take(byte)) {
        rtdac_usb_drop();
    } else if (!open_logic_armed()) {
        rtdac_usb_take(byte, !open_logic_tripped());
    } else {
        /* damage */
    }
}

void board_poll(void)
{
    for (int byte = hal_receive(); byte >= 0; byte = hal_receive()) {
        hal_lock();
        take((uint8_t)byte);
        hal_unlock();
    }
}
