import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from usb_monitor import BULK, CONTROL, LINUX_USB, LINUX_USB_MMAPPED, USBPCAP, Usbmon, UsbPcap

from inteco_abs.errors import CaptureError
from inteco_abs.wire.usbmon import LINK_TYPES, MonitoredUrb, decode

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

REAL_USBMON = bytes.fromhex(
    "c019d7510188ffff 53028028 0200 00 3c 9a48865800000000 d9340800 8dffffff 12000000 00000000 8006000100001200"
    "00000000 00000000 00020000 00000000"
)
"""A keyboard on bus 2, address 40, is asked for its descriptor; from a public capture."""
REAL_USBPCAP = bytes.fromhex("1c00 0840d684ffffffff 00000000 0b00 00 0100 0100 00 02 08000000 00 8006000100001200")
"""The same request to another device, on Windows; header as in a public capture."""


def decoded(packet, link_type, **options):
    try:
        return decode(packet, link_type, **options), ""
    except CaptureError as error:
        return None, str(error)


def test_a_header_of_a_real_usbmon_is_understood():
    urb = decode(REAL_USBMON, LINUX_USB_MMAPPED)
    assert urb == MonitoredUrb(
        2, 40, 0x80, CONTROL, 0xFFFF880151D719C0, False, "", 18, b"", bytes.fromhex("8006000100001200")
    )


def test_a_header_of_a_real_usbpcap_is_understood():
    urb = decode(REAL_USBPCAP, USBPCAP)
    assert urb == MonitoredUrb(
        1, 1, 0x00, CONTROL, 0xFFFFFFFF84D64008, False, "", 0, b"", bytes.fromhex("8006000100001200")
    )


@pytest.mark.parametrize("mmapped", [True, False])
@pytest.mark.parametrize("big_endian", [True, False])
@given(
    number=st.integers(0, (1 << 64) - 1),
    device=st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFF)),
    endpoint=st.integers(0, 0xFF),
    data=st.binary(min_size=1, max_size=600),
)
def test_usbmon_gives_back_what_was_put_in(mmapped, big_endian, number, device, endpoint, data):
    monitor = Usbmon(mmapped=mmapped, big_endian=big_endian)
    packet = monitor.packet(number, "C", endpoint, data, device=device)
    urb = decode(packet, monitor.link_type, big_endian=big_endian)
    assert urb == MonitoredUrb(*device, endpoint, BULK, number, True, "", len(data), data)


@given(
    number=st.integers(0, (1 << 64) - 1),
    device=st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)),
    endpoint=st.integers(0, 0xFF),
    data=st.binary(max_size=600),
)
def test_usbpcap_gives_back_what_was_put_in(number, device, endpoint, data):
    urb = decode(UsbPcap().packet(number, 1, endpoint, data, device=device), USBPCAP)
    assert urb == MonitoredUrb(*device, endpoint, BULK, number, True, "", len(data), data)


@given(packet=st.binary(max_size=700), link_type=st.sampled_from(sorted(LINK_TYPES)), big_endian=st.booleans())
def test_any_bytes_are_a_packet_or_one_clear_error(packet, link_type, big_endian):
    urb, problem = decoded(packet, link_type, big_endian=big_endian)
    assert problem if urb is None else urb.data in packet


@given(
    start=st.binary(min_size=8, max_size=8),
    rest=st.binary(min_size=54, max_size=600),
    kind=st.sampled_from(b"SCE"),
    transfer=st.integers(0, 3),
    link_type=st.sampled_from([LINUX_USB, LINUX_USB_MMAPPED]),
)
def test_a_packet_that_looks_like_usbmon_is_one_or_one_clear_error(start, rest, kind, transfer, link_type):
    packet = start + bytes([kind, transfer]) + rest
    urb, problem = decoded(packet, link_type)
    assert "of its" in problem if urb is None else urb.data in packet


def test_a_packet_shorter_than_its_data_says_what_to_do():
    monitor = Usbmon()
    packet = monitor.packet(1, "S", 2, bytes(504), status=-115)[:96]
    with pytest.raises(CaptureError, match=r"it has 32 of its 504 bytes of data.*without a length limit"):
        decode(packet, LINUX_USB_MMAPPED)


def test_a_failed_transfer_is_reported_by_its_status():
    assert decode(Usbmon().packet(1, "C", 2, status=-32), LINUX_USB_MMAPPED).failure == "status -32"
    assert decode(UsbPcap().packet(1, 1, 2, status=0xC0000004), USBPCAP).failure == "USBD status 0xC0000004"


def test_a_short_packet_is_not_a_failure():
    assert decode(Usbmon().packet(1, "C", 0x84, b"abc", status=-121), LINUX_USB_MMAPPED).failure == ""


def test_data_of_an_isochronous_transfer_begin_behind_its_descriptors():
    packet = bytearray(Usbmon().packet(1, "C", 0x81, b"sound", transfer=0))
    struct.pack_into("<I", packet, 60, 2)
    packet[64:64] = bytes(32)
    assert decode(bytes(packet), LINUX_USB_MMAPPED).data == b"sound"
