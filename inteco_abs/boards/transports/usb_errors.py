"""Texts for USB errors, one for each cause and both libraries."""

from __future__ import annotations

import errno
from typing import Final

from inteco_abs.boards.transports.links import PATIENCE_S
from inteco_abs.errors import LinkError, NoAnswerError

TIMEOUT_MS: Final = round(PATIENCE_S * 1e3)
AT_ONCE_MS: Final = 1
"""Shortest time-out of libusb, which counts whole milliseconds."""
RULES: Final = (
    "inteco-abs doctor --rules prints the udev rule that opens the board to the user at the computer and to the "
    "group of serial ports (sudo usermod -aG dialout $USER, then log in again); then plug the board in again"
)

_WORDS: Final = {
    errno.ENODEV: "the board is gone: check cable and power",
    errno.EIO: "the bus failed: check the cable, avoid hubs",
    errno.EPIPE: "the board refused the transfer (stall); the next one resets its pipe",
    errno.EACCES: f"no permission: {RULES}",
    errno.EBUSY: "another program has the board: end it, one program at a time",
    errno.EOVERFLOW: "the board sent more than requested: does another program use it, or is it another board?",
}
"""What to do, by errno, as pyusb gives it (docs/facts/usb.md#errors)."""


def failure(number: int | None, text: object, timeout_ms: float = TIMEOUT_MS) -> LinkError:
    """Return the error of a transfer that ended with errno `number`; for the arguments see `describe_usb_error`."""
    kind = NoAnswerError if number == errno.ETIMEDOUT else LinkError
    return kind(describe_usb_error(number, text, timeout_ms))


def describe_usb_error(number: int | None, text: object, timeout_ms: float = TIMEOUT_MS) -> str:
    """Return the text for errno `number`; `text` is the library's, for errors without one here."""
    if number == errno.ETIMEDOUT:
        return f"the board did not answer within {timeout_ms:g} ms: check its cable and power"
    return _WORDS.get(number or 0, f"the transfer failed: {text}")
