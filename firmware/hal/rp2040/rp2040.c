/* The Raspberry Pi Pico, RP2040: a Cortex-M0+ at 125 MHz. The line to the host is its USB device (usb.c). Encoders 0 to 3
   are at GPIO 2 to 9, A before B; PWM outputs 0 and 1 at GPIO 16 and 18; digital pins 0 to 5 at GPIO 10 to 15.

   The tick's interrupt stands above that of the encoders, so that no storm of edges can delay the watchdog; that of the
   USB controller below both. The chip's own watchdog resets it if tick or main loop stop: then no pin is driven. */

#include "board.h"
#include "cortex_m.h"
#include "hal.h"
#include "usb.h"

/* Peripherals (RP2040 datasheet); each register has an alias that sets bits and one that clears them. */
#define SET_BITS(address) REGISTER((address) + 0x2000u)
#define CLEAR_BITS(address) REGISTER((address) + 0x3000u)

#define RESETS 0x4000C000u
#define RESETS_DONE REGISTER(RESETS + 8u)
#define RESET_IO (1u << 5)
#define RESET_PADS (1u << 8)
#define RESET_PLLS (3u << 12)
#define RESET_PWM (1u << 14)
#define RESET_TIMER (1u << 21)
#define RESET_USB (1u << 24)

#define REFERENCE_CONTROL REGISTER(0x40008030u)
#define REFERENCE_SELECTED REGISTER(0x40008038u)
#define SYSTEM_CONTROL REGISTER(0x4000803Cu)
#define SYSTEM_SELECTED REGISTER(0x40008044u)
#define USB_CLOCK_CONTROL REGISTER(0x40008054u)
#define FROM_CRYSTAL 2u
#define FROM_PLL 1u
#define CLOCK_ENABLE (1u << 11)

#define CRYSTAL_CONTROL REGISTER(0x40024000u)
#define CRYSTAL_STATUS REGISTER(0x40024004u)
#define CRYSTAL_STARTUP REGISTER(0x4002400Cu)
#define CRYSTAL_ON 0x00FABAA0u /* 1 to 15 MHz */
#define CRYSTAL_STARTUP_DELAY 47u /* 1 ms at 12 MHz, in 256 cycles */
#define STABLE (1u << 31)

#define SYSTEM_PLL 0x40028000u
#define USB_PLL 0x4002C000u
#define PLL_LOCKED (1u << 31)
#define PLL_POWER_DOWN ((1u << 0) | (1u << 5))
#define PLL_DIVIDERS_DOWN (1u << 3)

#define PSM_WATCHDOG_SELECT REGISTER(0x40010008u)
#define ALL_BUT_OSCILLATORS 0x0001FFFCu
#define WATCHDOG 0x40058000u
#define WATCHDOG_LOAD REGISTER(WATCHDOG + 0x04u)
#define WATCHDOG_TICK REGISTER(WATCHDOG + 0x2Cu)
#define WATCHDOG_ENABLE (1u << 30)
#define WATCHDOG_US 50000u
#define TICK_ENABLE (1u << 9)
#define CRYSTAL_MHZ 12u

#define ALARM REGISTER(0x40054010u)
#define TIME_US REGISTER(0x40054028u)
#define TIMER_RAISED REGISTER(0x40054034u)
#define TIMER_INTERRUPTS REGISTER(0x40054038u)

#define PIN_CONTROL(pin) REGISTER(0x40014004u + 8u * (pin))
#define EDGES_RAISED(word) REGISTER(0x400140F0u + 4u * (word))
#define EDGES_ENABLED(word) REGISTER(0x40014100u + 4u * (word))
#define PAD(pin) REGISTER(0x4001C004u + 4u * (pin))
#define PAD_INPUT_UP 0x4Au   /* input, Schmitt trigger, pull-up */
#define PAD_INPUT_DOWN 0x46u /* the same with pull-down */
#define PAD_OUTPUT 0x56u     /* 4 mA, pull-down for the time in which it is not driven */
#define FUNCTION_PWM 4u
#define FUNCTION_SIO 5u
#define FORCED_LOW (2u << 8)

#define LEVELS REGISTER(0xD0000004u)
#define OUTPUT_LEVELS REGISTER(0xD0000010u)
#define OUTPUT_ENABLES REGISTER(0xD0000020u)

#define PWM_CONTROL(slice) REGISTER(0x40050000u + 0x14u * (slice))
#define PWM_DIVISOR(slice) REGISTER(0x40050004u + 0x14u * (slice))
#define PWM_COMPARE(slice) REGISTER(0x4005000Cu + 0x14u * (slice))
#define PWM_TOP(slice) REGISTER(0x40050010u + 0x14u * (slice))
#define PWM_PIN(channel) (16u + 2u * (channel)) /* output A of the slice with the channel's number */
#define DIVISOR_OF_40_MHZ 50u                   /* 125 MHz / 40 MHz in sixteenths */
#define LARGEST_DIVISOR 0xFFFu
#define FULL_8_BITS 255u
#define FULL_12_BITS 4095u

#define FLASH_ENABLE REGISTER(0x18000008u)
#define FLASH_FORMAT REGISTER(0x18000000u)
#define FLASH_SELECT REGISTER(0x18000010u)
#define FLASH_STATUS REGISTER(0x18000028u)
#define FLASH_DATA REGISTER(0x18000060u)
#define FLASH_CHIP_SELECT REGISTER(0x4001800Cu)
#define BYTES_BOTH_WAYS 0x00070000u
#define FLASH_RECEIVED (1u << 3)
#define READ_UNIQUE_ID 0x4Bu
#define FORCED_HIGH (3u << 8)

#define TICK_IRQ 0u
#define USB_IRQ 5u
#define EDGES_IRQ 13u
#define MIDDLE 0x40u /* priorities; 0 is the highest */
#define LOW 0x80u
#define VECTORS REGISTER(0xE000ED08u)

#define ENCODER_PIN 2u
#define ENCODER_PINS 0xFFu
#define ALL_EDGES_0 0xCCCCCC00u /* rising and falling, of GPIO 2 to 7 */
#define ALL_EDGES_1 0x000000CCu /* of GPIO 8 and 9 */
#define MOST_EDGES 1000u        /* in a tick; the rig's wheels make 130 in a millisecond */

#define DIGITAL_PIN 10u
#define DIGITAL_PINS 0x3Fu

static uint32_t period_us, next_us;
static uint64_t unique_id;
static uint8_t encoder_levels;
static volatile int32_t counts[HAL_COUNTERS];
static bool held[HAL_COUNTERS];
static volatile uint32_t edges;
static volatile bool tick_ran;

uint32_t hal_clock_us(void) {
    return TIME_US;
}

void hal_set_tick(uint32_t period) {
    period_us = period;
    next_us = TIME_US + period;
    ALARM = next_us;
}

int32_t hal_count(unsigned channel) {
    return held[channel] ? 0 : counts[channel];
}

void hal_hold_counter(unsigned channel, bool at_zero) {
    if (at_zero != held[channel]) { /* an edge may come in between, and counts from zero */
        counts[channel] = 0;
        held[channel] = at_zero;
    }
}

void hal_pwm(unsigned channel, uint16_t width, bool twelve_bits, uint16_t prescaler) {
    const uint32_t divisor = DIVISOR_OF_40_MHZ * ((uint32_t)prescaler + 1u);
    PWM_DIVISOR(channel) = (divisor < LARGEST_DIVISOR) ? divisor : LARGEST_DIVISOR;
    PWM_TOP(channel) = (twelve_bits ? FULL_12_BITS : FULL_8_BITS) - 1u;
    PWM_COMPARE(channel) = width;
    PIN_CONTROL(PWM_PIN(channel)) = FUNCTION_PWM | ((width == 0u) ? FORCED_LOW : 0u);
}

/* A width would end with its period only: the pins are forced low. */
void hal_outputs_off(void) {
    for (unsigned channel = 0; channel < HAL_PWMS; channel++) {
        PIN_CONTROL(PWM_PIN(channel)) = FUNCTION_PWM | FORCED_LOW;
        PWM_COMPARE(channel) = 0u;
    }
}

uint32_t hal_pins(void) {
    return (LEVELS >> DIGITAL_PIN) & DIGITAL_PINS;
}

void hal_set_pins(uint32_t value, uint32_t outputs) {
    OUTPUT_LEVELS = (value & DIGITAL_PINS) << DIGITAL_PIN;
    OUTPUT_ENABLES = (outputs & DIGITAL_PINS) << DIGITAL_PIN;
}

uint64_t hal_unique_id(void) {
    return unique_id;
}

/* Only the tick waits: the encoders' edges are closer to each other than a frame takes. */
void hal_lock(void) {
    NVIC_DISABLE = 1u << TICK_IRQ;
    __asm__ volatile("dsb\n isb" ::: "memory");
}

void hal_unlock(void) {
    __asm__ volatile("" ::: "memory");
    NVIC_ENABLE = 1u << TICK_IRQ;
}

/* Counts from the levels before and after: A rises before B when counting up. An edge that was missed makes both change,
   in a direction that cannot be known: it counts nothing. */
static void on_edges(void) {
    static const int8_t steps[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
    EDGES_RAISED(0u) = ALL_EDGES_0;
    EDGES_RAISED(1u) = ALL_EDGES_1;
    const uint8_t levels = (uint8_t)((LEVELS >> ENCODER_PIN) & ENCODER_PINS);
    uint32_t before = encoder_levels, now = levels;
    for (unsigned channel = 0; before != now; channel++) {
        counts[channel] += steps[((before & 3u) << 2) | (now & 3u)];
        before >>= 2;
        now >>= 2;
    }
    encoder_levels = levels;
    edges++;
}

static void on_tick(void) {
    TIMER_RAISED = 1u;
    next_us += period_us;
    if ((int32_t)(next_us - TIME_US) <= 1) { /* too late for it: the alarm only rings at its time */
        next_us = TIME_US + period_us;
    }
    ALARM = next_us;
    if (edges > MOST_EDGES) { /* a broken cable: the counters stand still, and the host sees that */
        EDGES_ENABLED(0u) = 0u;
        EDGES_ENABLED(1u) = 0u;
    }
    edges = 0u;
    tick_ran = true;
    board_tick();
}

static void on_fault(void) {
    hal_outputs_off();
    for (;;) { /* the chip's watchdog ends it */
    }
}

static void feed_watchdog(void) {
    if (tick_ran) {
        tick_ran = false;
        WATCHDOG_LOAD = 2u * WATCHDOG_US; /* it counts twice for a tick: erratum RP2040-E1 */
    }
}

static void release(uint32_t blocks) {
    CLEAR_BITS(RESETS) = blocks;
    while ((RESETS_DONE & blocks) != blocks) {
    }
}

static void start_pll(uint32_t pll, uint32_t multiplier, uint32_t dividers) {
    REGISTER(pll + 0x8u) = multiplier;
    CLEAR_BITS(pll + 0x4u) = PLL_POWER_DOWN;
    while ((REGISTER(pll) & PLL_LOCKED) == 0u) {
    }
    REGISTER(pll + 0xCu) = dividers;
    CLEAR_BITS(pll + 0x4u) = PLL_DIVIDERS_DOWN;
}

static void start_clocks(void) {
    CRYSTAL_STARTUP = CRYSTAL_STARTUP_DELAY;
    CRYSTAL_CONTROL = CRYSTAL_ON;
    while ((CRYSTAL_STATUS & STABLE) == 0u) {
    }
    SYSTEM_CONTROL = 0u; /* from the reference, while the PLL starts again after a reset of the chip's watchdog */
    while ((SYSTEM_SELECTED & 1u) == 0u) {
    }
    REFERENCE_CONTROL = FROM_CRYSTAL;
    while ((REFERENCE_SELECTED & (1u << FROM_CRYSTAL)) == 0u) {
    }
    SET_BITS(RESETS) = RESET_PLLS;
    release(RESET_PLLS);
    start_pll(SYSTEM_PLL, 125u, (6u << 16) | (2u << 12)); /* 12 MHz * 125 / 6 / 2 = 125 MHz */
    start_pll(USB_PLL, 100u, (5u << 16) | (5u << 12));    /* 12 MHz * 100 / 5 / 5 = 48 MHz */
    SYSTEM_CONTROL = FROM_PLL;
    while ((SYSTEM_SELECTED & (1u << FROM_PLL)) == 0u) {
    }
    USB_CLOCK_CONTROL = CLOCK_ENABLE; /* from its PLL */
    WATCHDOG_TICK = TICK_ENABLE | CRYSTAL_MHZ; /* 1 MHz, for the timer too */
}

static uint8_t exchange_with_flash(uint8_t byte) {
    FLASH_DATA = byte;
    while ((FLASH_STATUS & FLASH_RECEIVED) == 0u) {
    }
    return (uint8_t)FLASH_DATA;
}

/* The number of the flash chip. The program runs in RAM, so that the flash may be used otherwise from here on. */
static void read_unique_id(void) {
    FLASH_ENABLE = 0u;
    FLASH_FORMAT = BYTES_BOTH_WAYS;
    FLASH_SELECT = 1u;
    FLASH_ENABLE = 1u;
    FLASH_CHIP_SELECT = FORCED_LOW;
    (void)exchange_with_flash(READ_UNIQUE_ID);
    for (unsigned i = 0; i < 4u; i++) {
        (void)exchange_with_flash(0u);
    }
    for (unsigned i = 0; i < 8u; i++) {
        unique_id = (unique_id << 8) | exchange_with_flash(0u);
    }
    FLASH_CHIP_SELECT = FORCED_HIGH;
}

static void start_pins(void) {
    for (unsigned channel = 0; channel < HAL_PWMS; channel++) {
        PAD(PWM_PIN(channel)) = PAD_OUTPUT;
        PIN_CONTROL(PWM_PIN(channel)) = FUNCTION_PWM | FORCED_LOW;
        PWM_CONTROL(channel) = 1u;
    }
    for (unsigned pin = ENCODER_PIN; pin < (ENCODER_PIN + 2u * HAL_COUNTERS); pin++) {
        PAD(pin) = PAD_INPUT_UP; /* lines of open collectors, and of plugs that are not there */
        PIN_CONTROL(pin) = FUNCTION_SIO;
    }
    for (unsigned pin = DIGITAL_PIN; pin < (DIGITAL_PIN + 6u); pin++) {
        PAD(pin) = PAD_INPUT_DOWN;
        PIN_CONTROL(pin) = FUNCTION_SIO;
    }
    encoder_levels = (uint8_t)((LEVELS >> ENCODER_PIN) & ENCODER_PINS);
    EDGES_RAISED(0u) = ALL_EDGES_0;
    EDGES_RAISED(1u) = ALL_EDGES_1;
    EDGES_ENABLED(0u) = ALL_EDGES_0;
    EDGES_ENABLED(1u) = ALL_EDGES_1;
}

static void on_usb(void) {
    usb_interrupt();
}

__attribute__((section(".vectors"), used, aligned(256))) static const vector_t vectors[16u + EDGES_IRQ + 1u] = {
    stack_top,
    on_fault,
    on_fault,
    on_fault,
    [16u + TICK_IRQ] = on_tick,
    [16u + USB_IRQ] = on_usb,
    [16u + EDGES_IRQ] = on_edges,
};

/* Everything but the start, from here on in RAM. */
__attribute__((noinline, noreturn)) static void run(void) {
    mask_interrupts();
    VECTORS = (uint32_t)vectors;
    start_clocks();
    SET_BITS(RESETS) = RESET_IO | RESET_PADS | RESET_PWM | RESET_TIMER | RESET_USB;
    release(RESET_IO | RESET_PADS | RESET_PWM | RESET_TIMER | RESET_USB);
    read_unique_id();
    start_pins();
    TIMER_INTERRUPTS = 1u;
    board_reset();
    usb_start(unique_id);
    NVIC_PRIORITY(USB_IRQ / 4u) = LOW << (8u * (USB_IRQ % 4u));
    NVIC_PRIORITY(EDGES_IRQ / 4u) = MIDDLE << (8u * (EDGES_IRQ % 4u));
    NVIC_ENABLE = (1u << TICK_IRQ) | (1u << USB_IRQ) | (1u << EDGES_IRQ);
    PSM_WATCHDOG_SELECT = ALL_BUT_OSCILLATORS;
    WATCHDOG_LOAD = 2u * WATCHDOG_US;
    SET_BITS(WATCHDOG) = WATCHDOG_ENABLE;
    unmask_interrupts();
    for (;;) {
        board_poll();
        usb_resume();
        feed_watchdog();
        wait_for_event();
    }
}

/* In the flash: copies the program to RAM. */
__attribute__((section(".start"))) void on_reset(void) {
    start_memory();
    void (*const volatile in_ram)(void) = run; /* too far for a branch */
    in_ram();
    for (;;) {
    }
}

__attribute__((section(".first_vectors"), used)) static const vector_t first_vectors[2] = {stack_top, on_reset};
