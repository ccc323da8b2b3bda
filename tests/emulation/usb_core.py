"""What a kernel adds to a bus: enumeration, a configuration, and who has claimed the interface.

A bus is a `UsbHost`, or a client that has imported one: `submit`, `cancel`, `plugged`, `address`. Refusals are
OSErrors with the numbers of Linux' usbfs. Time-outs are in seconds, None for none.
"""

import errno
import struct
import threading
from types import SimpleNamespace

from inteco_abs.mock_board import Urb
from inteco_abs.mock_board.usbip.usb_device import SetupPacket

_DEVICE_FIELDS = [
    "bLength",
    "bDescriptorType",
    "bcdUSB",
    "bDeviceClass",
    "bDeviceSubClass",
    "bDeviceProtocol",
    "bMaxPacketSize0",
    "idVendor",
    "idProduct",
    "bcdDevice",
    "iManufacturer",
    "iProduct",
    "iSerialNumber",
    "bNumConfigurations",
]
_CONFIGURATION_FIELDS = [
    "bLength",
    "bDescriptorType",
    "wTotalLength",
    "bNumInterfaces",
    "bConfigurationValue",
    "iConfiguration",
    "bmAttributes",
    "bMaxPower",
]
_INTERFACE_FIELDS = [
    "bLength",
    "bDescriptorType",
    "bInterfaceNumber",
    "bAlternateSetting",
    "bNumEndpoints",
    "bInterfaceClass",
    "bInterfaceSubClass",
    "bInterfaceProtocol",
    "iInterface",
]
_ENDPOINT_FIELDS = ["bLength", "bDescriptorType", "bEndpointAddress", "bmAttributes", "wMaxPacketSize", "bInterval"]
HIGH_SPEED_PACKET = 512


def really_wait(event, timeout_s):
    return event.wait(timeout_s)


def _fields(names, layout, data):
    return SimpleNamespace(**dict(zip(names, struct.unpack_from(layout, data), strict=True)), extra_descriptors=[])


class UsbCore:
    """One device, from being plugged in to being unplugged. `driver` is that of the kernel, if one is bound."""

    def __init__(self, bus, wait=really_wait, driver=None):
        self.bus = bus
        self.address = bus.address
        self.driver = driver
        self._own_driver = driver
        self._wait = wait
        self._lock = threading.RLock()
        self._owner = None
        self.on_configuration = lambda _value: None
        self.descriptors = self.control(SetupPacket(0x80, 6, 0x0100, 0, 18))
        (total,) = struct.unpack_from("<2xH", self.control(SetupPacket(0x80, 6, 0x0200, 0, 9)))
        self.descriptors += self.control(SetupPacket(0x80, 6, 0x0200, 0, total))
        self.device = _fields(_DEVICE_FIELDS, "<BBHBBBBHHHBBBB", self.descriptors)
        self._parse(self.descriptors[18:])
        self._set_configuration(self.configuration_descriptor.bConfigurationValue)

    @property
    def present(self):
        return self.bus.plugged and self.bus.address == self.address

    def transfer(self, endpoint, timeout_s=1.0, **urb):
        """One transfer, until it ends or is cancelled for being late: the URB."""
        self.check_present()
        done = threading.Event()
        request = Urb(endpoint, lambda _urb: done.set(), **urb)
        self.bus.submit(request)
        if not self._wait(done, timeout_s):
            self.bus.cancel(request)
            assert done.wait(10), "a cancelled transfer did not end"
        return request

    def control(self, setup, data=b"", timeout_s=1.0):
        """Data, or the number of bytes sent; OSError with the status as its number."""
        urb = self.transfer(0x80 if setup.reads else 0, timeout_s, setup=setup, data=data, length=setup.length)
        if urb.status:
            raise OSError(-urb.status, "control transfer failed")
        return bytes(urb.received) if setup.reads else urb.actual

    def check_present(self):
        if not self.present:
            raise OSError(errno.ENODEV, "the device has gone")

    def set_configuration(self, value):
        with self._lock:
            self.check_present()
            if self._owner is not None or self.driver is not None:
                raise OSError(errno.EBUSY, "the interface is claimed")
            if value not in {0, self.configuration_descriptor.bConfigurationValue}:
                raise OSError(errno.EINVAL, "no such configuration")
            self._set_configuration(value)

    def claim(self, owner, interface):
        with self._lock:
            self.check_present()
            if interface or not self.configuration:
                raise OSError(errno.ENOENT, "no such interface")
            if self.driver is not None or self._owner not in {None, owner}:
                raise OSError(errno.EBUSY, "the interface is claimed")
            self._owner = owner

    @property
    def claimed(self):
        return self._owner is not None

    def holds(self, owner):
        return self._owner == owner

    def release(self, owner, interface=0):
        with self._lock:
            if interface or not self.holds(owner):
                raise OSError(errno.EINVAL, "the interface is not held")
            self._owner = None

    def close(self, owner):
        with self._lock:
            if self.holds(owner):
                self._owner = None

    def detach_driver(self):
        if self.driver is None:
            raise OSError(errno.ENODATA, "no driver is bound")
        self.driver = None

    def attach_driver(self):
        if self.claimed:
            raise OSError(errno.EBUSY, "the interface is claimed")
        self.driver = self._own_driver

    def set_interface(self, interface, alternate):
        if interface or alternate:
            raise OSError(errno.EINVAL, "no such setting")
        self.control(SetupPacket(0x01, 11, alternate, interface, 0))

    def clear_halt(self, endpoint):
        if endpoint not in {e.bEndpointAddress for e in self.endpoint_descriptors}:
            raise OSError(errno.ENOENT, "no such endpoint")
        self.control(SetupPacket(0x02, 1, 0, endpoint, 0))

    def reset(self):
        """Port reset; the kernel sets the configuration again."""
        self.check_present()
        self.bus.reset()
        self._set_configuration(self.configuration)

    def _set_configuration(self, value):
        self.control(SetupPacket(0x00, 9, value, 0, 0))
        self.configuration = value
        self.on_configuration(value)

    def _parse(self, data):
        self.endpoint_descriptors = []
        at = 0
        while at < len(data):
            match data[at + 1]:
                case 2:
                    self.configuration_descriptor = _fields(_CONFIGURATION_FIELDS, "<BBHBBBBB", data[at:])
                case 4:
                    self.interface_descriptor = _fields(_INTERFACE_FIELDS, "<9B", data[at:])
                case 5:
                    endpoint = _fields(_ENDPOINT_FIELDS, "<BBBBHB", data[at:])
                    endpoint.bRefresh = endpoint.bSynchAddress = 0
                    self.endpoint_descriptors.append(endpoint)
            at += data[at]
        high = self.endpoint_descriptors[0].wMaxPacketSize == HIGH_SPEED_PACKET
        vars(self.device).update(bus=1, address=self.address, port_number=1, port_numbers=(1,), speed=3 if high else 2)
