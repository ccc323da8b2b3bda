/* The emulated board: QEMU's mps2-an386, a Cortex-M4 at 25 MHz. Its UART 0 is the line to the host. It has no counters,
   PWM outputs or pins: those are in the process of the simulated rig, at a second line that QEMU's semihosting opens as
   the file `rig` in its working folder. A reading of the counters is one exchange on it: the rig moves to the board's
   present instant and answers. */

#include "board.h"
#include "cortex_m.h"
#include "hal.h"
#include "ring.h"

#define CLOCK_MHZ 25u

#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_INTERRUPT REGISTER(0x4000400Cu)
#define UART_DIVISOR REGISTER(0x40004010u)
#define UART_SENDING 1u   /* STATE */
#define UART_RECEIVED 2u  /* STATE */
#define UART_SENT_BIT 1u  /* INTERRUPT */
#define UART_RECEIVED_BIT 2u
#define UART_ENABLE 0xFu /* CONTROL: both directions and their interrupts */
#define SMALLEST_DIVISOR 16u

#define TIMER_CONTROL(n) REGISTER(0x40000000u + 0x1000u * (n))
#define TIMER_VALUE(n) REGISTER(0x40000004u + 0x1000u * (n))
#define TIMER_RELOAD(n) REGISTER(0x40000008u + 0x1000u * (n))
#define TIMER_INTERRUPT(n) REGISTER(0x4000000Cu + 0x1000u * (n))
#define CLOCK_TIMER 0u /* counts down all the time */
#define TICK_TIMER 1u
#define TIMER_ENABLE 1u
#define TIMER_WITH_INTERRUPT 9u

#define UART_RECEIVED_IRQ 0u
#define UART_SENT_IRQ 1u
#define TICK_IRQ 9u

/* Semihosting, of which the rig's line is made. */
#define SYS_OPEN 1
#define SYS_WRITE 5
#define SYS_READ 6
#define READ_AND_WRITE 3u

/* To the rig: clock, both widths, flags, levels and directions of the pins. From it: four counts and the pins. */
#define TWELVE_BITS 1u /* flag of PWM 0; of PWM 1 the next bit */
#define WANTS_COUNTS 4u
#define TICK_BEGINS 8u
#define WANTS_TICKS 0x80000000u /* bit of the pins from the rig: it keeps a record */
#define TO_RIG_WORDS 5u
#define FROM_RIG_WORDS 5u
#define ONE_READING_US 20u /* counters read within this time are latched together */

static ring_t received, sent;
static int32_t rig = -1;
static uint32_t clock_last, clock_rest, clock_us;
static uint16_t widths[HAL_PWMS];
static uint32_t modes, pin_levels, pin_outputs;
static uint32_t from_rig[FROM_RIG_WORDS];
static int32_t held_at[HAL_COUNTERS];
static bool held[HAL_COUNTERS];
static bool ever_read;
static uint32_t read_at_us;

static int32_t semihosting(int32_t operation, const void *arguments) {
    register int32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void open_rig(void) {
    static const char name[] = "rig";
    const struct {
        const char *name;
        uint32_t mode, length;
    } arguments = {name, READ_AND_WRITE, sizeof name - 1u};
    rig = semihosting(SYS_OPEN, &arguments);
}

/* Reads or writes a whole message; false if the rig is gone. */
static bool transfer(int32_t operation, uint8_t *bytes, uint32_t count) {
    while (count > 0u) {
        const struct {
            int32_t file;
            uint8_t *bytes;
            uint32_t count;
        } arguments = {rig, bytes, count};
        const int32_t left = semihosting(operation, &arguments);
        if ((left < 0) || ((uint32_t)left >= count)) {
            rig = -1;
            return false;
        }
        bytes = &bytes[count - (uint32_t)left];
        count = (uint32_t)left;
    }
    return true;
}

static void send_to_rig(uint32_t flags) {
    uint32_t message[TO_RIG_WORDS] = {
        hal_clock_us(), widths[0] | ((uint32_t)widths[1] << 16), modes | flags, pin_levels, pin_outputs,
    };
    if ((rig >= 0) && transfer(SYS_WRITE, (uint8_t *)message, sizeof message) && ((flags & WANTS_COUNTS) != 0u)) {
        (void)transfer(SYS_READ, (uint8_t *)from_rig, sizeof from_rig);
    }
}

static void read_rig(void) {
    if (!ever_read || ((hal_clock_us() - read_at_us) > ONE_READING_US)) {
        send_to_rig(WANTS_COUNTS);
        read_at_us = hal_clock_us();
        ever_read = true;
    }
}

uint32_t hal_clock_us(void) {
    const uint32_t now = ~TIMER_VALUE(CLOCK_TIMER);
    clock_rest += now - clock_last;
    clock_last = now;
    clock_us += clock_rest / CLOCK_MHZ;
    clock_rest %= CLOCK_MHZ;
    return clock_us;
}

void hal_set_tick(uint32_t period_us) {
    TIMER_CONTROL(TICK_TIMER) = 0u;
    TIMER_RELOAD(TICK_TIMER) = period_us * CLOCK_MHZ - 1u;
    TIMER_VALUE(TICK_TIMER) = period_us * CLOCK_MHZ - 1u;
    TIMER_CONTROL(TICK_TIMER) = TIMER_WITH_INTERRUPT;
}

int32_t hal_count(unsigned channel) {
    if (held[channel]) {
        return 0;
    }
    read_rig();
    return (int32_t)(from_rig[channel] - (uint32_t)held_at[channel]);
}

void hal_hold_counter(unsigned channel, bool at_zero) {
    if (held[channel] && !at_zero) {
        read_rig();
        held_at[channel] = (int32_t)from_rig[channel];
    }
    held[channel] = at_zero;
}

void hal_pwm(unsigned channel, uint16_t width, bool twelve_bits, uint16_t prescaler) {
    const uint32_t bit = TWELVE_BITS << channel;
    const uint32_t mode = twelve_bits ? (modes | bit) : (modes & ~bit);
    (void)prescaler; /* the simulated motors average every frequency */
    if ((width != widths[channel]) || (mode != modes)) {
        widths[channel] = width;
        modes = mode;
        send_to_rig(0u);
    }
}

void hal_outputs_off(void) {
    if ((widths[0] | widths[1]) != 0u) {
        widths[0] = 0u;
        widths[1] = 0u;
        send_to_rig(0u);
    }
}

uint32_t hal_pins(void) {
    read_rig();
    return (from_rig[4] & ~WANTS_TICKS & ~pin_outputs) | (pin_levels & pin_outputs);
}

void hal_set_pins(uint32_t value, uint32_t outputs) {
    if ((value != pin_levels) || (outputs != pin_outputs)) {
        pin_levels = value;
        pin_outputs = outputs;
        send_to_rig(0u);
    }
}

uint64_t hal_unique_id(void) {
    return 0u;
}

int hal_receive(void) {
    return (ring_used(&received) > 0u) ? (int)ring_take(&received) : -1;
}

static void pump(void) {
    while ((ring_used(&sent) > 0u) && ((UART_STATE & UART_SENDING) == 0u)) {
        UART_DATA = ring_take(&sent);
    }
}

bool hal_send(const uint8_t *bytes, unsigned count) {
    if (ring_free(&sent) < count) {
        return false;
    }
    for (unsigned i = 0; i < count; i++) {
        ring_put(&sent, bytes[i]);
    }
    pump();
    return true;
}

void hal_lock(void) {
    mask_interrupts();
}

void hal_unlock(void) {
    unmask_interrupts();
}

static void on_received(void) {
    UART_INTERRUPT = UART_RECEIVED_BIT;
    while ((UART_STATE & UART_RECEIVED) != 0u) {
        const uint8_t byte = (uint8_t)UART_DATA;
        if (ring_free(&received) > 0u) {
            ring_put(&received, byte);
        }
    }
}

static void on_sent(void) {
    UART_INTERRUPT = UART_SENT_BIT;
    pump();
}

static void on_tick(void) {
    TIMER_INTERRUPT(TICK_TIMER) = 1u;
    if ((from_rig[4] & WANTS_TICKS) != 0u) {
        send_to_rig(TICK_BEGINS);
    }
    board_tick();
}

static void on_fault(void) {
    hal_outputs_off();
    for (;;) {
    }
}

void on_reset(void) {
    start_memory();
    TIMER_RELOAD(CLOCK_TIMER) = 0xFFFFFFFFu;
    TIMER_VALUE(CLOCK_TIMER) = 0xFFFFFFFFu;
    TIMER_CONTROL(CLOCK_TIMER) = TIMER_ENABLE;
    open_rig();
    read_rig();
    mask_interrupts();
    board_reset();
    UART_DIVISOR = SMALLEST_DIVISOR;
    UART_CONTROL = UART_ENABLE;
    NVIC_ENABLE = (1u << UART_RECEIVED_IRQ) | (1u << UART_SENT_IRQ) | (1u << TICK_IRQ);
    for (;;) {
        unmask_interrupts();
        board_poll();
        mask_interrupts();
        if (ring_used(&received) == 0u) {
            wait_for_interrupt();
        }
    }
}

__attribute__((section(".vectors"), used)) static const vector_t vectors[16u + TICK_IRQ + 1u] = {
    stack_top,
    on_reset,
    on_fault,
    on_fault,
    on_fault,
    on_fault,
    on_fault,
    [16u + UART_RECEIVED_IRQ] = on_received,
    [16u + UART_SENT_IRQ] = on_sent,
    [16u + TICK_IRQ] = on_tick,
};
