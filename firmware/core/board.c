#include "board.h"

#include "hal.h"
#include "outputs.h"
#include "rtdac_usb.h"

#define IDLE_TICK_US 1000u /* the watchdog looks this often */

void board_reset(void)
{
    outputs_reset();
    rtdac_usb_reset();
    hal_set_tick(IDLE_TICK_US);
}

void board_tick(void)
{
    rtdac_usb_tick();
}

void board_poll(void)
{
    for (int byte = hal_receive(); byte >= 0; byte = hal_receive()) {
        hal_lock();
        (void)rtdac_usb_take((uint8_t)byte);
        hal_unlock();
    }
}
