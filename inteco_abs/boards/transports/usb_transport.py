"""Chooses between the two ways to move a tick's transfers over USB."""

from __future__ import annotations

import logging
from importlib.util import find_spec
from typing import Final

from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.usb import ONE_BY_ONE, UsbLink
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError

_EXTRA: Final = "needs the package libusb1: pip install inteco-abs[usb]"
_LOG: Final = logging.getLogger(__name__)


def open_usb(serial: str, ids: UsbConfig) -> Link:
    """Return a link to the board with decimal serial number `serial`, or to the only one; raises BoardError.

    Its engine is the configured one. With `faster` it queues, and a measurement may choose another of its `engines`;
    without the package libusb1 there is only one.
    """
    if ids.engine == ONE_BY_ONE:
        return UsbLink(serial, ids)
    if find_spec("usb1") is None:
        if ids.engine != "faster":
            raise BoardError(f'usb.engine = "{ids.engine}" {_EXTRA}')
        _LOG.warning("transfers go one by one, each waiting for the one before: to queue them %s", _EXTRA)
        return UsbLink(serial, ids)
    from inteco_abs.boards.transports.usb_async import QueuedUsbLink  # noqa: PLC0415  an extra

    link = QueuedUsbLink(serial, ids)
    if ids.engine != "faster":
        link.engines = ()
    return link
