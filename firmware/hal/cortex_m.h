/* What all Cortex-M chips have in common: registers, interrupts, and memory at reset. */

#ifndef CORTEX_M_H
#define CORTEX_M_H

#include <stdbool.h>
#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define NVIC_ENABLE REGISTER(0xE000E100u)
#define NVIC_DISABLE REGISTER(0xE000E180u)
#define NVIC_PRIORITY(word) REGISTER(0xE000E400u + 4u * (word))

typedef void (*vector_t)(void);

/* Where the program begins; each chip has its own. */
void on_reset(void);

static inline void mask_interrupts(void) {
    __asm__ volatile("cpsid i" ::: "memory");
}

static inline void unmask_interrupts(void) {
    __asm__ volatile("cpsie i" ::: "memory");
}

/* Sleeps until an interrupt is pending, even a masked one. */
static inline void wait_for_interrupt(void) {
    __asm__ volatile("wfi" ::: "memory");
}

/* Sleeps until an interrupt has been handled; not at all if one was since the last time. */
static inline void wait_for_event(void) {
    __asm__ volatile("wfe" ::: "memory");
}

/* From the linker script. The first is no function, but stands in the table of vectors, before them. */
extern void stack_top(void);
extern uint32_t data_begin[], data_end[], data_image[], bss_begin[], bss_end[];

/* Copies initial values to RAM and clears the rest, before anything that is static is used. */
static inline void start_memory(void) {
    const uint32_t *from = data_image;
    for (uint32_t *to = data_begin; to < data_end; to++) {
        *to = *from;
        from++;
    }
    for (uint32_t *to = bss_begin; to < bss_end; to++) {
        *to = 0u;
    }
}

#endif
