"""PWM outputs of all RT-DAC boards: one clock, a 16-bit prescaler, an 8-bit and a 12-bit mode.

Confirmed for RT-DAC4/PCI (manual section 3.1) and RT-DAC/USB2 (an example in S1 agrees), inferred for RT-DAC/USB of
the first generation, whose fields have the same sizes.
"""

from __future__ import annotations

from typing import Final

PWM_CLOCK_HZ: Final = 40_000_000
PWM_FULL_WIDTH: Final = (255, 4095)
"""Width of a full period, by PWM mode: 0 is 8-bit, 1 is 12-bit."""
PWM_MODES: Final = ("8-bit", "12-bit")
"""Names of the modes, by number."""


def pwm_frequency_hz(mode: int, prescaler: int) -> float:
    """PWM frequency in Hz of mode 0 (8-bit) or 1 (12-bit) and prescaler 0..65535."""
    return PWM_CLOCK_HZ / ((prescaler + 1) * PWM_FULL_WIDTH[mode])
