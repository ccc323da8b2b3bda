/* Numbers in frames: little-endian, at the places of the generated tables. */

#ifndef FRAME_H
#define FRAME_H

#include <stdint.h>

/* Place of a number: from bit 0 of its first byte on, which travels first. */
struct place {
    uint8_t byte;
    uint8_t bits; /* 1 to 32 */
};

uint32_t frame_get(const uint8_t *frame, struct place place);

/* Leaves bits of the last byte that are not the number's. */
void frame_put(uint8_t *frame, struct place place, uint32_t value);

/* CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, highest bit first. */
uint16_t frame_crc(const uint8_t *bytes, unsigned count);

#endif
