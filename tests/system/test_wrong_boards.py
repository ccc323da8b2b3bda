"""Boards that are not there, are two, are another's or may not be driven: nothing is moved, and nothing is left."""

import errno
from types import SimpleNamespace

import pytest
import usb.core
import usb.util
from wrong_inputs import Row, ids

from inteco_abs.boards.transports.usb import ENDPOINTS

RULES = "inteco-abs doctor --rules prints the udev rule"


class Plugged:
    """A device on the USB, as pyusb has it."""

    idVendor, idProduct, manufacturer = 0x04B4, 0x8613, "InTeCo"
    bDeviceClass, bus, address, port_numbers = 0xFF, 1, 7, (2,)

    def __init__(self, serial="7", *, denied=False) -> None:
        self._serial, self._denied = serial, denied

    @property
    def serial_number(self):
        if self._denied:
            raise ValueError("The device has no langid")
        return self._serial

    def __getitem__(self, _configuration):
        return {(0, 0): [SimpleNamespace(bEndpointAddress=address) for address in ENDPOINTS]}

    def is_kernel_driver_active(self, _interface):
        return True

    def detach_kernel_driver(self, _interface):
        raise usb.core.USBError("busy", -6, errno.EBUSY)


def bus(*devices):
    """What is plugged into the USB."""
    return (lambda place: place.patch.setattr(usb.core, "find", lambda **_: devices),)


def disposable(place):
    place.patch.setattr(usb.util, "dispose_resources", lambda _device: None)


def no_libusb(place):
    def find(**_named):
        raise usb.core.NoBackendError("No backend available")

    place.patch.setattr(usb.core, "find", find)


ROWS = [
    Row("no such kind", "run --board usb3:", 2, ("'usb3:' is not a board address",), "sim: is the mock"),
    Row("no address", "run --board ''", 2, ("'' is not a board address",), "sim: is the mock"),
    Row("no colon", "run --board usb2", 2, ("'usb2' is not a board address",), "did you mean usb2:?"),
    Row("a path alone", "run --board /dev/ttyUSB0", 2, ("'/dev/ttyUSB0'",), "did you mean usb:/dev/ttyUSB0?"),
    Row("something behind the mock", "run --board sim:7", 2, ("'sim:7'",), "nothing may follow sim:"),
    Row("no decimal serial number", "run --board usb2:A1", 2, ("'usb2:A1'",), "as in usb2:123"),
    Row("no PCI address", "run --board pci:7", 2, ("'pci:7'",), "as in pci:0000:03:0a.0"),
    Row("no serial port's path", "run --board usb:ttyUSB0", 2, ("'usb:ttyUSB0'",), "as in usb:/dev/ttyUSB0"),
    Row("another kind's profile", "run --board pci: --set profile=usb1_0111", 2, ("board.kind: 'usb'", "pci:"),
        "name another profile"),
    Row("the mock's profile", "run --board pci: --set profile=sim_pci", 2, ("board.simulated",),
        "inteco-abs commission"),
    Row("frames of a board without", "run --virtual --set profile=sim_pci --frames", 2, ("--frames",), "registers"),
    Row("nothing plugged in", "identify-led", 1, ("no RT-DAC/USB2 board", "maker is 'InTeCo' (usb.manufacturer)"),
        "is it plugged in?", bus()),
    Row("two boards", "identify-led", 1, ("2 boards", "serial '7'", "serial '8'"), "name one, as in usb2:7",
        bus(Plugged("7"), Plugged("8"))),
    Row("another serial number", "identify-led --board usb2:9", 1, ("with serial number 9", "serial '7'"),
        "is it plugged in?",
        bus(Plugged("7"))),
    Row("no permission", "identify-led", 1, ("04b4:8613 (no permission)",), RULES, bus(Plugged(denied=True))),
    Row("held by the kernel", "identify-led", 1, ("a kernel driver holds the board",), "sudo modprobe -r NAME",
        (*bus(Plugged()), disposable)),
    Row("no libusb", "identify-led", 1, ("no libusb on this computer",), "install libusb-1.0-0", (no_libusb,)),
    Row("nothing to commission", "commission --board pci: --yes-read-only", 1, ("no device for pci:", "step 1"),
        "plug the board in",
        leaves=("rig-profile.toml", "rig-profile.results.json")),
    Row("an unsigned profile", "run --virtual --set profile=usb2_generic_0103", 1, ("reading only",),
        "inteco-abs commission makes a profile"),
    Row("outputs switched off", "run --virtual --set board.read_only='cable cut'", 1, ("reading only",),
        "cable cut"),
    Row("a board of another name", "run --virtual --set board.application_names=[]", 1, ("'ABSSIM'", "knows none yet"),
        "inteco-abs commission makes a profile"),
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=ids(ROWS))
def test_a_wrong_board_gets_one_clear_answer(answers, row):
    answers.to(row)


@pytest.mark.untraced
@pytest.mark.xdist_group("real time")
def test_a_run_without_its_board_leaves_no_folder_behind(inteco_abs, tmp_path):
    run = inteco_abs("run", "--board", "usb2:5", check=1)
    assert "no RT-DAC/USB2 board with serial number 5: is it plugged in?" in run.stderr
    assert run.stdout == ""
    assert list(tmp_path.iterdir()) == []
