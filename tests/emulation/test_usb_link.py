"""The driver's USB link over pyusb, with the mock board on the bus in process."""

import pytest
from pyusb_backend import BusBackend
from trouble import halt_of

from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.boards.transports.usb import ENDPOINTS, UsbLink, usb_boards
from inteco_abs.config import UsbConfig, load_config
from inteco_abs.errors import BoardError, LinkError
from inteco_abs.mock_board import Device, Urb, UsbBoard, UsbHost, UsbIdentity, UsbSpeed
from inteco_abs.mock_board.usbip.usb_device import SetupPacket
from inteco_abs.signals import BoardFlags, Command

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SERIAL = 900_000_123
PERIOD_NS = 500_000


class Clock:
    def __init__(self):
        self.time_ns = 0

    def now_ns(self):
        return self.time_ns


class Bus:
    """One mock board on a bus of its own, and what a driver needs to open it."""

    def __init__(self, speed=UsbSpeed.HIGH, serial=SERIAL, **identity):
        self.clock = Clock()
        self.config = load_config()
        self.device = Device(self.config, self.clock.now_ns, 1)
        self.board = UsbBoard(Usb2FrontEnd(self.device), UsbIdentity(serial=serial, speed=speed, **identity))
        self.host = UsbHost(self.board)
        self.backend = BusBackend(self.host)

    def status(self, endpoint):
        """What the device answers to GET_STATUS: bit 0 of an endpoint's first byte is its halt."""
        urb = Urb(0x80, lambda _urb: None, setup=SetupPacket(0x82, 0, 0, endpoint, 2), length=2)
        self.host.submit(urb)
        return bytes(urb.received)

    def link(self, serial=""):
        return UsbLink(serial, self.config.usb, self.backend)

    def driver(self):
        return RtdacUsb2(self.link(), self.config.board, self.clock.now_ns, PERIOD_NS)


@pytest.fixture(params=UsbSpeed, ids=lambda speed: speed.name.lower())
def bus(request):
    return Bus(request.param)


def test_the_board_is_found_by_its_maker_and_serial_number(bus):
    (seen,) = usb_boards(bus.config.usb, bus.backend)
    assert (seen.manufacturer, seen.serial) == ("InTeCo", str(SERIAL))
    bus.link().close()
    bus.link(str(SERIAL)).close()
    bus.link(f"000{SERIAL}").close()  # compared as decimal integers


def test_another_serial_number_or_maker_or_id_is_another_board(bus):
    with pytest.raises(BoardError, match=f"no RT-DAC/USB2 board with serial number 7: .*{SERIAL}"):
        bus.link("7")
    for ids, named in (
        (UsbConfig(manufacturer="Somebody"), "'Somebody' (usb.manufacturer). Seen: 04b4:8613 'InTeCo'"),
        (
            UsbConfig(vendor_id=0x1234),
            "'InTeCo' (usb.manufacturer) with vendor id 1234 (usb.vendor_id). Seen: no similar device",
        ),
        (UsbConfig(product_id=1), "with product id 0001 (usb.product_id)"),
    ):
        with pytest.raises(BoardError, match="is it plugged in") as refusal:
            UsbLink("", ids, bus.backend)
        assert named in str(refusal.value)


def test_a_board_of_the_maker_is_found_with_any_ids():
    bus = Bus(vendor_id=0x1234, product_id=0x5678)
    bus.link().close()
    UsbLink("", UsbConfig(manufacturer="inteco", vendor_id=0x1234), bus.backend).close()


@pytest.mark.parametrize("missing", ENDPOINTS)
def test_a_device_without_one_of_the_boards_four_endpoints_is_refused(missing):
    bus = Bus(endpoints=tuple(endpoint for endpoint in ENDPOINTS if endpoint != missing))
    with pytest.raises(BoardError, match=f"not an RT-DAC/USB2: endpoint 0x{missing:02x} is missing, the device has 0x"):
        bus.link()


@pytest.mark.parametrize("halted", ENDPOINTS)
def test_an_endpoint_left_halted_recovers_without_replugging(halted):
    bus = Bus()
    bus.host.submit(halt_of(halted))
    with bus.driver() as board:
        assert not board.exchange(Command.SAFE).board_flags
    assert bus.status(halted) == b"\0\0"
    assert bus.board.jtag_transfers == 0


def test_a_whole_exchange_goes_over_the_bus_as_it_does_in_process(bus):
    with bus.driver() as board:
        for _ in range(400):
            bus.clock.time_ns += PERIOD_NS
            sample = board.exchange(Command(1.0, 0.0))
        assert sample.board_flags is BoardFlags.NONE
        assert sample.road_count > 0
        assert bus.device.duties == (1.0, 0.0)
    assert bus.device.duties == (0.0, 0.0)
    assert bus.board.jtag_transfers == 0


def test_the_same_run_gives_the_same_samples_over_usb_and_in_process(bus):
    from inteco_abs.boards import InProcessLink

    def samples(new_driver, clock):
        with new_driver as board:
            made = []
            for number in range(300):
                clock.time_ns += PERIOD_NS
                made.append(board.exchange(Command(0.8 if number < 200 else 0.0, 0.0 if number < 200 else 0.6)))
            return made

    other = Bus()
    plain = RtdacUsb2(InProcessLink(Usb2FrontEnd(other.device)), other.config.board, other.clock.now_ns, PERIOD_NS)
    assert samples(bus.driver(), bus.clock) == samples(plain, other.clock)


def test_a_board_has_one_program_at_a_time(bus):
    first = bus.link()
    with pytest.raises(BoardError, match="another program has the board: end it"):
        bus.link()
    first.close()
    bus.link().close()


def test_a_silent_board_raises_a_link_error(bus):
    link = bus.link()
    with pytest.raises(LinkError, match="did not answer within 10 ms"):
        link.read(504)
    link.discard(504)
    link.close()


def test_an_unplugged_board_is_distinguished_from_a_silent_one(bus):
    board = bus.driver().__enter__()
    bus.clock.time_ns += PERIOD_NS
    board.exchange(Command(0.5, 0.0))
    bus.host.unplug()
    sample = board.exchange(Command(0.5, 0.0))
    assert sample.board_flags is BoardFlags.STALE
    assert "is gone" in str(board.last_error)
    with pytest.raises(BoardError, match="MOTOR POWER MAY STILL BE ON"):
        board.__exit__(None, None, None)
