"""The driver on real kernels: Debian's, stock and PREEMPT_RT, each in a QEMU guest in virtual time.

pyusb and libusb, or pyserial, work on devices that the kernel has enumerated; a USB/IP server in the guest is the
board. What was achieved is printed after the tests; it is a model of what a computer's instructions cost, and says
nothing about a real board, cable or host controller.
"""

import json
import os
import shlex
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from check_list import CHECKS
from guest import kernel, machine

from firmware_protocol.rtdac_pci import LOGIC, LOGIC_VERSION, PWM_PRESCALER
from inteco_abs.analysis import replay_session
from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline, control_check
from inteco_abs.sessions import read_session, session_config

ROOT = Path(__file__).parents[2]
PATHS = f"{ROOT}{os.pathsep}{Path(__file__).parent}"
SPEEDS = {"full": "12", "high": "480"}

# no test in real time holds its pace beside an emulator
pytestmark = [pytest.mark.long, pytest.mark.xdist_group("real time")]


class Outcome(NamedTuple):
    """What a guest reported, and the folder with all that it left."""

    report: dict
    results: Path


def lacking(what):
    if os.environ.get("CI"):
        pytest.fail(what)
    pytest.skip(what)


@pytest.fixture(scope="module", params=kernel.META_PACKAGES)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def scenario(kind, tmp_path_factory):
    """Runs a scenario in a guest with the kernel, and with what `prepare`, if given, adds to it."""

    def run(name, prepare=lambda _results: ()):
        if to_install := machine.missing():
            lacking(f"what the guests need is missing: {to_install}")
        try:
            guests_kernel = kernel.fetch(kind)
        except kernel.MissingError as missing:
            lacking(f"no kernel for the guest: {missing}")
        results = tmp_path_factory.mktemp(f"{name}-{kind}")
        environment = {
            "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
            "HOME": "/dev/shm",  # noqa: S108 - the guest's own
            "TMPDIR": "/dev/shm",  # noqa: S108
            "PYTHONDONTWRITEBYTECODE": "1",
            "PYTHONPATH": PATHS,
            "KERNEL_FOLDER": guests_kernel.folder,
        }
        settings = [f"{key}={value}" for key, value in environment.items()]
        script = shlex.join(["env", "-i", *settings, sys.executable, "-m", f"guest.{name}"])
        code, console = machine.run(guests_kernel, script, results, prepare(results))
        assert code == 0, console
        return Outcome(json.loads((results / "report.json").read_text()), results)

    return run


def stand_ins(results):
    """Two functions with registers at base address register 2: memory that is a file here, and I/O ports."""
    memory = bytearray(1 << 16)
    memory[LOGIC.offset : LOGIC.offset + 4] = LOGIC_VERSION.to_bytes(4, "little")
    (results / "registers").write_bytes(memory)
    backend = f"memory-backend-file,id=m,mem-path={results / 'registers'},size=64K,share=on"
    return "-object", backend, "-device", "ivshmem-plain,memdev=m", "-device", "megasas"


@pytest.fixture(scope="module")
def pci(scenario):
    return scenario("pci", stand_ins)


@pytest.fixture(scope="module")
def usb2(scenario):
    return scenario("usb2")


def assert_it_stopped(stop):
    assert stop["exit_code"] in {0, 3}, stop["messages"]  # 3: done, with periods overrun or exchanges failed
    card, turning = stop["card"], stop["turning"]
    assert (card["outcome"], card["stops"]) == ("completed", 1)
    assert card["start_speed_rad_s"] > 150.0
    assert 1.0 < card["stop_time_s"] < 2.0
    assert turning["ticks"] > 6 * stop["rate_hz"]
    assert turning["overruns"] + turning["failed_or_slow"] < 0.01 * turning["ticks"]
    assert turning["io_us"]["p99"] < 1e6 / stop["rate_hz"]
    # where the simulated wheels begin and cease to turn they cost more than this processor has
    assert card["overruns"] + card["link_errors"] < 0.1 * card["ticks"]
    assert (stop["realtime"]["scheduler"], stop["realtime"]["memory"]) == ("SCHED_FIFO 80", "locked")


def assert_it_replays(stop, results):
    assert (stop["replay"]["exit_code"], stop["replay"]["differing"]) == (0, 0)
    session = read_session(results / "stop.mcap")
    again = replay_session(session, build_pipeline(session_config(session, (control_check(),))))
    assert (again.ticks, again.differing) == (stop["card"]["ticks"], 0)


def figures_of(kind, report):
    """What is printed after the tests."""
    stop, card, rate_hz = report["stop"], report["stop"]["card"], report["stop"]["rate_hz"]
    turning = stop["turning"]
    figures = ", ".join(f"{name} {us:.0f}" for name, us in turning["io_us"].items())
    lines = [
        f"guest with the {kind} kernel: {report['kernel']}",
        *report["log"],
        *(f"{name}: {json.dumps(facts)}" for name, facts in report["devices"].items()),
        f"{card['ticks']} ticks at {rate_hz} Hz, {card['overruns']} overruns, {card['link_errors']} link errors",
        f"outcome {card['outcome']}; {stop['replay']['differing']} ticks differ when replayed",
        f"while the wheels turn: {turning['overruns']} overruns, {turning['failed_or_slow']} exchanges failed or slow",
        f"exchange with the board meanwhile, us of virtual time: {figures}",
        f"guardian drill: {stop['realtime']['guardian drill']}",
    ]
    return "\n".join(lines)


class TestUsb2:
    def test_the_kernel_is_the_intended_one(self, usb2, kind):
        name = usb2.report["kernel"]
        assert name.startswith("Linux ")
        assert ("PREEMPT_RT" in name) == (kind == "rt")

    @pytest.mark.parametrize("speed", SPEEDS)
    @pytest.mark.parametrize("check", CHECKS)
    def test_check_passes_in_the_guest(self, usb2, speed, check):
        failure = usb2.report["checks"][speed][check]
        assert failure is None, failure

    @pytest.mark.parametrize("speed", SPEEDS)
    def test_it_is_enumerated_as_what_it_is(self, usb2, speed):
        device = usb2.report["devices"][speed]
        assert (device["idVendor"], device["idProduct"], device["manufacturer"]) == ("04b4", "8613", "InTeCo")
        assert (device["speed"], device["driver"]) == (SPEEDS[speed], "")
        assert device["endpoints"] == ["02", "06", "84", "88"]

    def test_the_kernel_reports_it(self, usb2):
        log = "\n".join(usb2.report["log"])
        assert "new full-speed USB device number 2 using vhci_hcd" in log
        assert "USB disconnect, device number 3" in log
        assert "new high-speed USB device number 4 using vhci_hcd" in log
        assert "Product: RT-DAC/USB2 (mock, simulated rig)" in log

    def test_the_udev_rule_opens_it_and_keeps_it_awake(self, usb2):
        for device in usb2.report["devices"].values():
            assert (device["group"], device["mode"], device["power_control"]) == ("dialout", "0660", "on")

    def test_a_braking_stop_is_complete(self, usb2, kind, record_property):
        record_property("figures", figures_of(kind, usb2.report))
        assert_it_stopped(usb2.report["stop"])

    def test_the_stop_replays(self, usb2):
        assert_it_replays(usb2.report["stop"], usb2.results)


@pytest.fixture(scope="module")
def ftdi(scenario):
    return scenario("ftdi")


class TestFtdi:
    """The first RT-DAC/USB: its chip, the kernel's `ftdi_sio`, pyserial."""

    def test_the_kernels_driver_makes_a_port_of_it(self, ftdi):
        device = ftdi.report["devices"]["mock"]
        assert (device["idVendor"], device["idProduct"], device["driver"]) == ("0403", "6001", "ftdi_sio")
        assert device["endpoints"] == ["02", "81"]
        log = "\n".join(ftdi.report["log"])
        assert "FTDI USB Serial Device converter detected" in log
        assert "now attached to ttyUSB0" in log

    def test_the_udev_rule_sets_the_latency_timer_of_the_chip_that_is_named(self, ftdi):
        assert ftdi.report["port"] == {"name": "ttyUSB0", "latency_timer": "1"}

    def test_an_answer_waits_for_the_latency_timer(self, ftdi):
        """Its last packet is not full; the times are virtual, so they may be judged."""
        assert 16_000 < ftdi.report["reading_us"]["16"] < 18_000
        assert 1_000 < ftdi.report["reading_us"]["1"] < 3_000

    def test_a_braking_stop_is_complete(self, ftdi, kind, record_property):
        record_property("figures", figures_of(kind, ftdi.report))
        assert_it_stopped(ftdi.report["stop"])

    def test_the_stop_replays(self, ftdi):
        assert_it_replays(ftdi.report["stop"], ftdi.results)


_IO, _MEMORY = 0x100, 0x200


class TestPci:
    """The driver of the RT-DAC4/PCI on a real kernel's resource files. What answers there is not the board."""

    def test_registers_that_are_switched_off_are_refused_with_what_to_do(self, pci):
        for message in pci.report["off"].values():
            assert "is switched off: echo 1 | sudo tee" in message
            assert "doctor --rules" in message

    def test_the_udev_rule_switches_them_on_and_opens_them_to_the_group(self, pci):
        for what, flag in (("memory", _MEMORY), ("ports", _IO)):
            files = pci.report["files"][what]
            assert (files["enable"], files["group"], files["mode"]) == ("1", "dialout", "0660")
            assert files["flags"] & (_IO | _MEMORY) == flag
            assert files["bytes"] >= 256

    def test_a_user_of_the_group_reads_and_writes_memory_and_ports(self, pci):
        assert pci.report["logic"] == LOGIC_VERSION
        assert pci.report["mask"] == 0x5A

    def test_any_other_user_is_referred_to_the_rules(self, pci):
        for message in pci.report["stranger"].values():
            assert "resource2 cannot be opened: no permission: inteco-abs doctor --rules" in message

    def test_of_two_boards_one_must_be_named(self, pci):
        assert "2 RT-DAC4/PCI boards: name one" in pci.report["which"]

    def test_only_one_program_at_a_time_can_hold_them(self, pci):
        assert "another program has the board" in pci.report["taken"]

    def test_the_driver_enters_the_board_and_its_writes_arrive_at_the_far_side(self, pci):
        assert pci.report["driver"] == {"identity": f"logic 0x{LOGIC_VERSION:04X}", "flags": [0] * 10}
        far = (pci.results / "registers").read_bytes()
        prescaler = int.from_bytes(far[PWM_PRESCALER.offset : PWM_PRESCALER.offset + 4], "little")
        assert prescaler == load_config(profile="pci_abs_50f").board.pwm_prescaler

    def test_a_locked_down_kernel_refuses_both_and_the_words_name_secure_boot(self, pci):
        memory, ports = pci.report["locked"]["memory"], pci.report["locked"]["ports"]
        assert "cannot be mapped: the kernel is locked down and forbids it: switch Secure Boot off" in memory
        assert "cannot be written: the kernel is locked down and forbids it: switch Secure Boot off" in ports
        assert any("direct PCI access is restricted" in line for line in pci.report["log"])
