"""A backend that gives pyusb a bus of the emulation instead of libusb's.

Errors carry libusb's codes and pyusb's errno, by a table of our own: pyusb's is private.
"""

import errno
from contextlib import contextmanager

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError
from usb_core import UsbCore, really_wait

from inteco_abs.mock_board.usbip.usb_device import SetupPacket

_IO, _ACCESS, _NO_DEVICE, _NOT_FOUND, _BUSY, _TIMEOUT, _OVERFLOW, _PIPE, _OTHER = -1, -3, -4, -5, -6, -7, -8, -9, -99
_CODES = {
    errno.EPROTO: _IO,
    errno.EILSEQ: _IO,
    errno.ETIME: _IO,
    errno.EACCES: _ACCESS,
    errno.ENODEV: _NO_DEVICE,
    errno.ESHUTDOWN: _NO_DEVICE,
    errno.ENOENT: _NOT_FOUND,
    errno.EINVAL: _NOT_FOUND,
    errno.ENODATA: _NOT_FOUND,
    errno.EBUSY: _BUSY,
    errno.EOVERFLOW: _OVERFLOW,
    errno.EPIPE: _PIPE,
}
_ERRNOS = {
    _IO: errno.EIO,
    _ACCESS: errno.EACCES,
    _NO_DEVICE: errno.ENODEV,
    _NOT_FOUND: errno.ENOENT,
    _BUSY: errno.EBUSY,
    _OVERFLOW: errno.EOVERFLOW,
    _PIPE: errno.EPIPE,
    _OTHER: None,
}
_CANCELLED = {-errno.ENOENT, -errno.ECONNRESET}


def _error(number):
    code = _CODES.get(number, _OTHER)
    return USBError(f"libusb error {code}", code, _ERRNOS[code])


@contextmanager
def _as_libusb():
    try:
        yield
    except USBError:
        raise
    except OSError as error:
        if -error.errno in _CANCELLED - {-errno.ENOENT}:
            raise USBTimeoutError("timed out", _TIMEOUT, errno.ETIMEDOUT) from error
        raise _error(error.errno) from error


def _seconds(milliseconds):
    return milliseconds / 1000 or None


class _Handle:
    """One open device file."""

    def __init__(self, core):
        self.core = core


class BusBackend(IBackend):
    """`wait(event, timeout_s)` returns whether the event came in time; a clock's own makes time-outs virtual."""

    def __init__(self, bus, wait=really_wait):
        super().__init__()
        self._bus = bus
        self._wait = wait
        self._core = None
        self.driver = None
        self.permitted = True

    def enumerate_devices(self):
        if not self._bus.plugged:
            return iter(())
        if self._core is None or not self._core.present:
            try:
                self._core = UsbCore(self._bus, self._wait, self.driver)
            except OSError:
                return iter(())  # it has just gone
        return iter((self._core,))

    def get_parent(self, dev):  # noqa: ARG002
        return None

    def get_device_descriptor(self, dev):
        return dev.device

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise _error(errno.ENOENT)
        return dev.configuration_descriptor

    def get_interface_descriptor(self, dev, intf, alt, config):
        if intf or alt or config:
            raise IndexError("there is one interface with one setting")
        return dev.interface_descriptor

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        self.get_interface_descriptor(dev, intf, alt, config)
        return dev.endpoint_descriptors[ep]

    def open_device(self, dev):
        with _as_libusb():
            dev.check_present()
            if not self.permitted:
                raise _error(errno.EACCES)
        return _Handle(dev)

    def close_device(self, dev_handle):
        dev_handle.core.close(dev_handle)

    def set_configuration(self, dev_handle, config_value):
        with _as_libusb():
            dev_handle.core.set_configuration(config_value)

    def get_configuration(self, dev_handle):
        return dev_handle.core.configuration

    def set_interface_altsetting(self, dev_handle, intf, altsetting):
        with _as_libusb():
            if not dev_handle.core.holds(dev_handle):
                raise _error(errno.ENOENT)
            dev_handle.core.set_interface(intf, altsetting)

    def claim_interface(self, dev_handle, intf):
        with _as_libusb():
            dev_handle.core.claim(dev_handle, intf)

    def release_interface(self, dev_handle, intf):
        with _as_libusb():
            dev_handle.core.release(dev_handle, intf)

    def bulk_write(self, dev_handle, ep, intf, data, timeout):  # noqa: ARG002
        return self._transfer(dev_handle, ep, timeout, data=data.tobytes()).actual

    def bulk_read(self, dev_handle, ep, intf, buff, timeout):  # noqa: ARG002
        return self._fill(buff, self._transfer(dev_handle, ep, timeout, length=len(buff) * buff.itemsize))

    intr_write = iso_write = bulk_write
    intr_read = iso_read = bulk_read

    def ctrl_transfer(self, dev_handle, bmRequestType, bRequest, wValue, wIndex, data, timeout):
        setup = SetupPacket(bmRequestType, bRequest, wValue, wIndex, len(data) * data.itemsize)
        out = b"" if setup.reads else data.tobytes()
        urb = self._transfer(
            dev_handle, 0x80 if setup.reads else 0, timeout, setup=setup, data=out, length=setup.length
        )
        return self._fill(data, urb) if setup.reads else urb.actual

    def clear_halt(self, dev_handle, ep):
        with _as_libusb():
            dev_handle.core.clear_halt(ep)

    def reset_device(self, dev_handle):
        with _as_libusb():
            dev_handle.core.reset()

    def is_kernel_driver_active(self, dev_handle, intf):  # noqa: ARG002
        return dev_handle.core.driver is not None

    def detach_kernel_driver(self, dev_handle, intf):  # noqa: ARG002
        with _as_libusb():
            dev_handle.core.detach_driver()

    def attach_kernel_driver(self, dev_handle, intf):  # noqa: ARG002
        with _as_libusb():
            dev_handle.core.attach_driver()

    @staticmethod
    def _transfer(handle, endpoint, timeout, **urb):
        """The URB that has ended well, or was cancelled after some data; else the error."""
        with _as_libusb():
            done = handle.core.transfer(endpoint, _seconds(timeout), **urb)
        if done.status in _CANCELLED:
            if not done.actual:
                raise USBTimeoutError("timed out", _TIMEOUT, errno.ETIMEDOUT)
        elif done.status:
            raise _error(-done.status)
        return done

    @staticmethod
    def _fill(buffer, urb):
        memoryview(buffer).cast("B")[: len(urb.received)] = bytes(urb.received)
        return len(urb.received)
