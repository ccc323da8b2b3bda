"""Two ways to move a tick's transfers over USB, and which of them is quicker on this computer with this board."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Final

from firmware_protocol.rtdac_usb2 import FRAME_BYTES, READ_REQUEST
from inteco_abs.boards.links import Link
from inteco_abs.boards.usb import UsbLink
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

_TRIALS: Final = 200
_JUDGED: Final = 0.99

Opener = Callable[[], Link]


def open_usb(serial: str, ids: UsbConfig) -> Link:
    """Link to the board with decimal serial number `serial`, or to the only one; raises BoardError.

    The engine is the configured one, or the faster: the quicker at the 99th percentile of two hundred readings,
    which change nothing on the board.
    """
    if ids.engine == "one-by-one":
        return UsbLink(serial, ids)
    if find_spec("usb1") is None:
        if ids.engine == "queued":
            raise BoardError('usb.engine = "queued" needs the package libusb1: pip install inteco-abs[usb]')
        return UsbLink(serial, ids)
    from inteco_abs.boards.usb_queued import QueuedUsbLink  # noqa: PLC0415  an extra

    if ids.engine == "queued":
        return QueuedUsbLink(serial, ids)
    return _faster(lambda: UsbLink(serial, ids), lambda: QueuedUsbLink(serial, ids))


def _faster(simple: Opener, queued: Opener) -> Link:
    """Open both, one after the other as a board has one host at a time, and keep the quicker."""
    simple_us = _reading_us(simple())
    try:
        link = queued()
    except BoardError:
        return simple()  # this libusb or bus has no use for it
    queued_us = _reading_us(link, keep=True)
    if queued_us < simple_us:
        return link
    link.close()
    return simple()


def _reading_us(link: Link, *, keep: bool = False) -> float:
    """How long a READ takes, us, at the 99th percentile; without end if one fails."""
    times_us = []
    try:
        link.discard(FRAME_BYTES)
        for _ in range(_TRIALS):
            start_ns = time.monotonic_ns()
            link.write(READ_REQUEST)
            link.read(FRAME_BYTES)
            times_us.append((time.monotonic_ns() - start_ns) * 1e-3)
    except LinkError:
        return float("inf")
    finally:
        if not keep:
            link.close()
    return sorted(times_us)[int(_JUDGED * _TRIALS)]
