"""What errors of the USB mean to the person at the rig: one text for each cause, whoever moved the transfer."""

from __future__ import annotations

import errno
from typing import Final

TIMEOUT_MS: Final = 10
"""Far below the window after which a silent loop counts as hung; libusb knows whole milliseconds only."""
AT_ONCE_MS: Final = 1
"""The least that libusb can be asked to wait."""
RULES: Final = (
    "inteco-abs doctor --rules prints the udev rule that opens the board to whoever sits at the computer and to the "
    "group of serial ports (sudo usermod -aG dialout $USER, then log in again); then plug the board in again"
)

_WORDS: Final = {
    errno.ENODEV: "the board is gone: check cable and power",
    errno.EIO: "the bus failed: check the cable, avoid hubs",
    errno.EPIPE: "the board refused the transfer (stall): if it goes on, plug the board in again",
    errno.EACCES: f"no permission: {RULES}",
    errno.EBUSY: "another program has the board: end it, one program at a time",
    errno.EOVERFLOW: "the board sent more than was asked for: does another program use it, or is it another board?",
}
"""By errno, as pyusb gives it (fact sheet on emulated hardware, section 4)."""


def in_words(number: int | None, told: object, timeout_ms: int = TIMEOUT_MS) -> str:
    """Text for the errno `number`; `told` is what the library says, for what has no text here."""
    if number == errno.ETIMEDOUT:
        return f"the board did not answer within {timeout_ms} ms: check its cable and power"
    return _WORDS.get(number or 0, f"the transfer failed: {told}")
