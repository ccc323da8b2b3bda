#include "rtdac_usb.h"

#include "frame.h"
#include "hal.h"
#include "outputs.h"
#include "rtdac_usb_tables.h"

#define COMMAND_BIT 0x80u
#define ALL_PINS ((UINT32_C(1) << HAL_PINS) - 1u)
#define EIGHT_BITS 255u
#define TIMERS 2u
#define TIMER_TICKS_PER_US 20u /* the vendor's timers count at 20 MHz */
#define MOVES (sizeof rtdac_usb_moves / sizeof rtdac_usb_moves[0])

static struct {
    uint8_t image[RTDAC_USB_READ_BYTES]; /* the READ frame */
    uint8_t frame[RTDAC_USB_SEND_BYTES]; /* data bytes of the SEND frame that arrives */
    unsigned arrived;                    /* how many of them there are */
    bool open;                           /* whether a SEND frame arrives */
    bool expired;                        /* whether widths stay off until all of them are zero */
    uint32_t timer_start_us[TIMERS];
} vendor;

static uint32_t get(struct place place)
{
    return frame_get(vendor.image, place);
}

static void put(struct place place, uint32_t value)
{
    frame_put(vendor.image, place, value);
}

static bool bit(uint32_t bits, unsigned number)
{
    return ((bits >> number) & 1u) != 0u;
}

/* One output as the image has it. A channel whose pin is not a PWM pin is off. */
static struct pwm output(unsigned channel)
{
    const bool connected = bit(get(rtdac_usb_pin_mode), channel);
    const bool twelve_bits = get(rtdac_usb_pwm_mode[channel]) != 0u;
    const uint32_t width = get(rtdac_usb_pwm_width[channel]) & (twelve_bits ? 0xFFFFu : EIGHT_BITS);
    const struct pwm pwm = {
        .width = connected ? (uint16_t)width : 0u,
        .prescaler = (uint16_t)get(rtdac_usb_pwm_prescaler[channel]),
        .twelve_bits = twelve_bits,
    };
    return pwm;
}

static void apply_outputs(void)
{
    struct pwm pwm[HAL_PWMS];
    bool on = false;
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        pwm[i] = output(i);
        on = on || (pwm[i].width != 0u);
    }
    vendor.expired = vendor.expired && on;
    if (vendor.expired) {
        rtdac_usb_show_off();
    } else {
        outputs_apply(pwm);
        outputs_feed(RTDAC_USB_WATCHDOG_US);
    }
}

/* Timers that were held at zero until now, or are from now on, start now. */
static void start_timers(uint32_t held)
{
    for (unsigned i = 0u; i < TIMERS; i++) {
        if (bit(held, i)) {
            vendor.timer_start_us[i] = hal_clock_us();
        }
    }
}

static void send(void)
{
    const uint32_t held = get(rtdac_usb_timer_reset);
    for (unsigned i = 0u; i < MOVES; i++) {
        const struct bit_move move = rtdac_usb_moves[i];
        const unsigned ones = (1u << move.width) - 1u;
        const unsigned moved = ((unsigned)vendor.frame[move.send_byte] >> move.send_low) & ones;
        uint8_t *byte = &vendor.image[move.read_byte];
        *byte = (uint8_t)((*byte & ~(ones << move.read_low)) | (moved << move.read_low));
    }
    start_timers(held | get(rtdac_usb_timer_reset));
    for (unsigned i = 0u; i < HAL_COUNTERS; i++) {
        hal_hold_counter(i, bit(get(rtdac_usb_encoder_reset), i));
    }
    hal_set_pins(get(rtdac_usb_pin_output), get(rtdac_usb_pin_direction) ^ ALL_PINS); /* direction 1 is an input */
    apply_outputs();
}

static uint32_t timer(unsigned i)
{
    const uint32_t running = get(rtdac_usb_timer_mode) & ~get(rtdac_usb_timer_reset);
    return bit(running, i) ? (hal_clock_us() - vendor.timer_start_us[i]) * TIMER_TICKS_PER_US : 0u;
}

static void read(void)
{
    for (unsigned i = 0u; i < TIMERS; i++) {
        put(rtdac_usb_timer_value[i], timer(i));
    }
    for (unsigned i = 0u; i < HAL_COUNTERS; i++) {
        put(rtdac_usb_encoder_count[i], (uint32_t)hal_count(i));
    }
    put(rtdac_usb_pin_input, hal_pins());
    (void)hal_send(vendor.image, RTDAC_USB_READ_BYTES); /* a host that does not read misses the answer */
}

void rtdac_usb_reset(void)
{
    for (unsigned i = 0u; i < RTDAC_USB_READ_BYTES; i++) {
        vendor.image[i] = rtdac_usb_start[i];
    }
    start_timers(~0u);
    for (unsigned i = 0u; i < HAL_COUNTERS; i++) {
        hal_hold_counter(i, false);
    }
    hal_set_pins(0u, 0u);
    vendor.expired = false;
    rtdac_usb_drop();
}

void rtdac_usb_take(uint8_t byte, bool may_set)
{
    if ((byte & COMMAND_BIT) != 0u) {
        rtdac_usb_drop();
        vendor.open = (byte == RTDAC_USB_SEND);
        if (byte == RTDAC_USB_READ) {
            read();
        }
    } else if (vendor.open) {
        vendor.frame[vendor.arrived] = byte;
        vendor.arrived++;
        if (vendor.arrived == RTDAC_USB_SEND_BYTES) {
            rtdac_usb_drop();
            if (may_set) {
                send();
            }
        }
    } else {
        /* a byte of no message */
    }
}

void rtdac_usb_drop(void)
{
    vendor.open = false;
    vendor.arrived = 0u;
}

bool rtdac_usb_tick(void)
{
    const bool trips = outputs_on() && outputs_expired();
    if (trips) {
        outputs_trip(RTDAC_USB_TRIP);
        rtdac_usb_show_off();
        vendor.expired = true;
    }
    return trips;
}

void rtdac_usb_show_off(void)
{
    for (unsigned i = 0u; i < HAL_PWMS; i++) {
        put(rtdac_usb_pwm_width[i], 0u);
    }
}
