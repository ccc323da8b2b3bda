"""The report of a commissioning: nothing personal in it, and a mock made from it answers as the board did."""

import getpass
import json
import platform
from datetime import date
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.commissioning.anonymous_report import board_seen
from inteco_abs.commissioning.board_from_report import ReportedBoard
from inteco_abs.config import load_config
from inteco_abs.errors import AbsError, CaptureError, ConfigError
from inteco_abs.mock_board import Device, UsbBoard, UsbIdentity, ftdi_identity, rig_check
from inteco_abs.mock_board.usbip.usb_device import SetupPacket
from inteco_abs.signals import Command
from inteco_abs.wire.capture import read_capture, write_capture

READING = ("list", "header", "reads", "wheels")
KINDS = {"usb2": "usb2_generic_0103", "usb": "usb1_0111", "pci": "pci_abs_50f"}
DESCRIPTORS = b"".join(UsbIdentity(product="x").descriptor(kind, 0) for kind in (1, 2))
ODD = DESCRIPTORS[:12] + b"\x34\x12" + bytes((3, 1, 2)) + DESCRIPTORS[17:]
"""Another release, and strings in another order."""
FTDI = b"".join(ftdi_identity().descriptor(kind, 0) for kind in (1, 2))


@pytest.fixture
def reported(lab, scripts, tmp_path):
    """Walks steps 1 to 4 on the mock of a board; the file with its report."""

    def procedure(kind="usb2", stated=None):
        if kind == "usb2":
            lab.done_until("echo")
        else:
            procedure = lab.session(*(answer for name in READING for answer in scripts[name]), profile=KINDS[kind])
            for name in READING:
                procedure.go(only=name)
        if stated is not None:
            listed = lab.draft.results["list"]
            device = {"address": "sim:", "description": "", "told": stated}
            lab.draft.record("list", {**listed, "devices": [device]})
        file = tmp_path / "board.jsonl"
        write_capture(file, board_seen(lab.draft))
        return file

    return procedure


def plugged_in(file):
    """Everything that `mock-board --from-report` does with the file."""
    seen = ReportedBoard(file)
    mocked(seen)
    return seen.identity(UsbIdentity())


def mocked(seen):
    """Mock board of a report and its configuration."""
    config = load_config(settings=seen.settings, checks=[rig_check], profile=seen.profile)
    clock = [0]
    return config, seen.front_end(Device(config, lambda: clock[0], 7)), clock


@pytest.mark.parametrize("kind", KINDS)
def test_mock_made_of_a_report_begins_as_the_reported_board_with_the_rig(reported, kind):
    seen = ReportedBoard(reported(kind))
    first = read_capture(seen.path).records
    config, front_end, clock = mocked(seen)
    board = board_behind(InProcessLink(front_end), config, lambda: clock[0])
    with board.reading():
        raw = board.survey().raw
    assert raw == next(one.data for one in first if one.kind == "in")
    with board_behind(InProcessLink(front_end), config, lambda: clock[0]) as board:
        board.require_writable()
        for _ in range(400):
            clock[0] += 1_000_000
            sample = board.exchange(Command(0.5, 0.0))
    assert sample.road_count > 100
    assert front_end.device.duties == (0.0, 0.0)


@pytest.mark.parametrize(("raw", "like"), [(ODD, UsbIdentity()), (FTDI, ftdi_identity())], ids=["usb2", "ftdi"])
def test_its_descriptors_are_those_of_the_board_and_its_serial_number_is_a_mocks(reported, raw, like):
    stated = {"descriptors": raw.hex(), "manufacturer": "InTeCo", "product": "RT-DAC", "serial": "77", "speed": "480"}
    identity = ReportedBoard(reported(stated=stated)).identity(like)
    assert identity.descriptor(1, 0) + identity.descriptor(2, 0) == raw
    manufacturer, product, serial = raw[14:17]
    texts = [identity.descriptor(3, index)[2:].decode("utf-16-le") for index in (manufacturer, product, serial)]
    assert texts == ["InTeCo", "RT-DAC", str(like.serial)]
    assert identity.endpoints == like.endpoints


def test_a_host_reads_them_from_the_mock(reported):
    seen = ReportedBoard(reported(stated={"descriptors": ODD.hex(), "manufacturer": "InTeCo", "speed": "480"}))
    _, front_end, _ = mocked(seen)
    device = UsbBoard(front_end, seen.identity(UsbIdentity()))
    assert device.control(SetupPacket(0x80, 6, 0x0100, 0, 18)) == ODD[:18]


def test_what_was_seen_is_in_it(lab, reported):
    stated = {
        "descriptors": ODD.hex(),
        "manufacturer": "InTeCo",
        "product": "RT-DAC/USB2",
        "serial": "A77",
        "speed": "12",
    }
    capture = read_capture(reported(stated=stated))
    report = capture.report
    assert report.identity.application_name == "ABSSIM"
    assert (report.bus.descriptors, report.bus.serial_form, report.bus.speed) == (ODD.hex(), "x99", "12")
    assert report.reads.count == 1000
    assert report.profile["board"]["wheel_encoder"] == lab.draft.config.board.wheel_encoder
    assert report.computer["kernel"] == platform.release()
    images = [one.data for one in capture.records if one.kind == "in"]
    assert len(images) == len(report.images) == 4
    assert images[1] != images[2] != images[3]


names = st.text(st.characters(codec="utf-8", categories=["L"]), min_size=4, max_size=30).map("qx{}xq".format)
"""No part of a word that the report has of its own, as `uppe` is."""
serials = st.from_regex(r"[A-Z]?[0-9]{4,9}", fullmatch=True)


@settings(deadline=None, max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(user=names, host=names, serial=serials)
def test_nothing_personal_is_in_it(lab, monkeypatch, user, host, serial):
    lab.done_until("sign")
    draft = lab.draft
    draft.write({"board.evidence.drive_pwm": {"status": "confirmed", "source": f"by {user}"}})
    draft.write({"board.verified_by": user, "board.verified_on": date(2026, 5, 17), "board.verified_logic": 0x103})
    draft.write({"session.spill": f"/home/{user}/runs", "usb.manufacturer": f"InTeCo {serial}"})
    stated = {"descriptors": ODD.hex(), "manufacturer": f"{host} {serial}", "product": f"of {user}", "serial": serial}
    draft.record("list", {"outcome": "done", "devices": [{"address": f"usb2:{serial}", "told": stated}]})
    draft.record("motors", {"outcome": "failed", "problem": f"/home/{user}/x.toml on {host}"})
    monkeypatch.setattr(getpass, "getuser", lambda: user)
    monkeypatch.setattr(platform, "node", lambda: host)
    monkeypatch.setattr(platform, "release", lambda: f"6.1-{host}")
    monkeypatch.setattr(Path, "home", lambda: Path(f"/home/{user}"))
    file = lab.file.with_name("report.jsonl")
    file.unlink(missing_ok=True)
    write_capture(file, board_seen(draft))
    report = json.loads(file.read_text().partition("\n")[0])["report"]
    assert report["bus"].pop("descriptors") == ODD.hex()  # it has every digit
    for text in texts(report):
        for name in (user, host, serial, f"/home/{user}"):
            assert name.casefold() not in text.replace("(removed)", "").casefold()
    assert "2026-05-17" not in file.read_text()


def texts(value):
    """Every text within."""
    if isinstance(value, dict):
        return [text for one in value.values() for text in texts(one)]
    if isinstance(value, list):
        return [text for one in value for text in texts(one)]
    return [value] if isinstance(value, str) else []


def test_before_the_board_was_read_there_is_nothing_to_report(lab):
    lab.session()
    with pytest.raises(ConfigError, match="do step 2, header, first"):
        board_seen(lab.draft)


def test_a_capture_without_a_report_makes_no_mock(reported):
    file = reported()
    head, *rest = file.read_text().splitlines(keepends=True)
    plain = {key: value for key, value in json.loads(head).items() if key != "report"}
    file.write_text("".join([json.dumps(plain) + "\n", *rest]))
    with pytest.raises(CaptureError, match="not the report of a commissioning"):
        ReportedBoard(file)


WRONG = {
    "kind": ({"kind": "vme"}, "report.kind"),
    "another kind": ({"kind": "pci"}, "but report.kind = 'pci'"),
    "more": ({"owner": "me"}, "report.owner"),
    "no table": (7, "report = '7'"),
    "no hex": ({"bus": {"descriptors": "zz"}}, "report.bus.descriptors"),
    "long": ({"computer": {"cpu": "x" * 1000}}, "report.computer.cpu"),
    "histogram": ({"reads": {"count": 1, "failed": 0, "histogram_us": {"now": 1}}}, "report.reads.histogram_us.now"),
    "negative": ({"reads": {"count": -1, "failed": 0}}, "report.reads.count"),
    "cut descriptors": ({"bus": {"descriptors": ODD[:30].hex()}}, "report.bus.descriptors"),
    "wiring": ({"profile": {"board": {"drive_pwm": 99}}}, "simulation.drive_pwm"),
    "wiring of texts": ({"profile": {"board": {"road_sign": "$(x)"}}}, "simulation.road_sign"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_report_that_is_wrong_is_refused_by_the_name_of_what_is_wrong(reported, what):
    changes, stated = WRONG[what]
    file = reported()
    head, *rest = file.read_text().splitlines(keepends=True)
    head = json.loads(head)
    head["report"] = head["report"] | changes if isinstance(changes, dict) else changes
    file.write_text("".join([json.dumps(head) + "\n", *rest]))
    with pytest.raises(AbsError, match=stated):
        plugged_in(file)


@pytest.mark.parametrize("length", [0, 4, 511])
def test_an_image_of_another_length_is_refused(reported, length):
    file = reported()
    lines = file.read_text().splitlines()
    lines[2] = json.dumps(json.loads(lines[2]) | {"hex": "00" * length})
    file.write_text("\n".join([*lines[:3], ""]))
    with pytest.raises(CaptureError, match=f"an image of {length} bytes"):
        mocked(ReportedBoard(file))
