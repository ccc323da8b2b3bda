/* A queue of bytes with one writer and one reader, of which each may be an interrupt. */

#ifndef RING_H
#define RING_H

#include <stdint.h>

#define RING_BYTES 512u /* a power of two; three answers of the vendor's logic */

typedef struct {
    volatile uint8_t bytes[RING_BYTES];
    volatile uint32_t written, taken;
} ring_t;

static inline uint32_t ring_used(const ring_t *ring) {
    return ring->written - ring->taken;
}

static inline uint32_t ring_free(const ring_t *ring) {
    return RING_BYTES - ring_used(ring);
}

/* Only while ring_free(ring) > 0. */
static inline void ring_put(ring_t *ring, uint8_t byte) {
    ring->bytes[ring->written % RING_BYTES] = byte;
    ring->written++;
}

/* Only while ring_used(ring) > 0. */
static inline uint8_t ring_take(ring_t *ring) {
    const uint8_t byte = ring->bytes[ring->taken % RING_BYTES];
    ring->taken++;
    return byte;
}

#endif
