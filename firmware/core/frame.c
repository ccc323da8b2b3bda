#include "frame.h"

#define CRC_START 0xFFFFu
#define CRC_POLYNOMIAL 0x1021u
#define BITS_OF_BYTE 8u

uint32_t frame_get(const uint8_t *frame, struct place place)
{
    uint32_t value = 0u;
    for (unsigned bit = 0u; bit < place.bits; bit += BITS_OF_BYTE) {
        value |= (uint32_t)frame[place.byte + (bit / BITS_OF_BYTE)] << bit;
    }
    return value & (UINT32_MAX >> (32u - place.bits));
}

void frame_put(uint8_t *frame, struct place place, uint32_t value)
{
    const uint32_t mask = UINT32_MAX >> (32u - place.bits);
    for (unsigned bit = 0u; bit < place.bits; bit += BITS_OF_BYTE) {
        uint8_t *byte = &frame[place.byte + (bit / BITS_OF_BYTE)];
        *byte = (uint8_t)((*byte & ~(mask >> bit)) | ((value & mask) >> bit));
    }
}

uint16_t frame_crc(const uint8_t *bytes, unsigned count)
{
    unsigned crc = CRC_START;
    for (unsigned i = 0u; i < count; i++) {
        crc ^= (unsigned)bytes[i] << BITS_OF_BYTE;
        for (unsigned bit = 0u; bit < BITS_OF_BYTE; bit++) {
            crc = ((crc & 0x8000u) != 0u) ? ((crc << 1u) ^ CRC_POLYNOMIAL) : (crc << 1u);
        }
    }
    return (uint16_t)crc;
}
