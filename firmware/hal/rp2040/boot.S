/* The 256 bytes that the chip's boot ROM copies from the flash to RAM and runs: they let the flash be read as memory,
   with the serial read command 03h that every flash chip knows, and start the program behind them. The last four bytes
   are a checksum, which image.py adds. */

    .file "boot.S" @ else the name of a temporary file, which changes from build to build
    .syntax unified
    .cpu cortex-m0plus
    .thumb
    .section .boot, "ax"
    .global boot
    .thumb_func
boot:
    ldr  r3, =0x18000000        @ the interface to the flash
    movs r1, #0
    str  r1, [r3, #0x08]        @ off
    movs r1, #4
    str  r1, [r3, #0x14]        @ a quarter of the system's clock
    ldr  r1, =0x001F0300        @ CTRLR0: one data line, 32 bits, reads after a command
    str  r1, [r3, #0x00]
    movs r1, #0
    str  r1, [r3, #0x04]        @ CTRLR1: one word for a read
    ldr  r1, =0x03000218        @ SPI_CTRLR0: command 03h of 8 bits, address of 24
    ldr  r2, =0xF4
    str  r1, [r3, r2]
    movs r1, #1
    str  r1, [r3, #0x08]        @ on
    ldr  r0, =0x10000100        @ the program's first vectors
    ldr  r1, =0xE000ED08        @ VTOR
    str  r0, [r1]
    ldr  r1, [r0, #0]
    msr  msp, r1
    ldr  r1, [r0, #4]
    bx   r1
    .ltorg
