#!/usr/bin/env python3
"""Makes what the RP2040 is flashed with: image.py PROGRAM.bin IMAGE.bin IMAGE.uf2.

Adds the boot ROM's checksum to the first 256 bytes, and divides the image into UF2 blocks, which the chip's own USB
disk takes.
"""

import struct
import sys
from pathlib import Path

FLASH = 0x10000000
BOOT_BYTES = 256
BLOCK_BYTES = 256
UF2_START = 0x0A324655, 0x9E5D5157
UF2_END = 0x0AB16F30
WITH_FAMILY = 0x2000
RP2040 = 0xE48BFF56
CRC32 = 0x04C11DB7


def checksum(data: bytes) -> int:
    """Return the CRC-32 that the boot ROM checks: not reflected, begun with ones, not inverted."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte << 24
        for _ in range(8):
            register = (register << 1 ^ (CRC32 if register >> 31 else 0)) & 0xFFFFFFFF
    return register


def main(program: str, image: str, uf2: str) -> None:
    data = Path(program).read_bytes()
    boot = data[: BOOT_BYTES - 4]
    data = boot + struct.pack("<I", checksum(boot)) + data[BOOT_BYTES:]
    data += bytes(-len(data) % BLOCK_BYTES)
    Path(image).write_bytes(data)
    count = len(data) // BLOCK_BYTES
    with Path(uf2).open("wb") as file:
        for i in range(count):
            at = i * BLOCK_BYTES
            head = struct.pack("<8I", *UF2_START, WITH_FAMILY, FLASH + at, BLOCK_BYTES, i, count, RP2040)
            file.write(head + data[at : at + BLOCK_BYTES].ljust(476, b"\0") + struct.pack("<I", UF2_END))


if __name__ == "__main__":
    main(*sys.argv[1:])
