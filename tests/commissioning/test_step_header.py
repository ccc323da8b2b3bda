"""Steps 1 to 3: what is there, who it is, how fast it answers."""

import pytest

from inteco_abs.boards import Identity
from inteco_abs.commissioning.exchange_rate import kept_rate
from inteco_abs.commissioning.identity import fitting_profile, hex_dump
from inteco_abs.config import load_config
from inteco_abs.errors import CommissioningError, ConfigError, LinkError
from inteco_abs.host.attached import found_devices
from inteco_abs.host.checks import Computer


def board(version, name=""):
    return Identity(version, name, "20260101", "")


@pytest.mark.parametrize(
    ("kind", "version", "fitting"),
    [
        ("usb2", 0x0103, "usb2_generic_0103"),
        ("usb2", 0x0777, "usb2_abs_candidate"),
        ("usb", 0x0112, "usb1_0112"),
        ("usb", 0x0111, "usb1_0111"),
        ("usb", 0x0113, "usb1_abs_candidate"),
        ("pci", 0x050F, "pci_abs_50f"),
    ],
)
def test_the_profile_made_for_the_logic_is_suggested_else_the_candidate(kind, version, fitting):
    assert fitting_profile(kind, board(version)) == fitting


def test_the_header_is_written_into_the_draft(lab):
    lab.session("", "", settings=["board.logic_version=0x0777", 'board.application_names=["OLD"]'])
    lab.procedure.go(only="list")
    lab.procedure.go(only="header")
    config = load_config(profile=str(lab.file))
    assert config.board.logic_version == 0x0103
    assert config.board.application_names == ["ABSSIM"]
    found = lab.draft.results["header"]
    assert (found["logic_version"], found["application_name"], found["synthesis_date"]) == (
        "0x0103",
        "ABSSIM",
        "20260101",
    )
    assert len(bytes.fromhex(found["raw"])) == 504
    assert found["channels"]["encoder_channels"] == 8


@pytest.mark.parametrize(("answer", "base"), [("yes", "usb2_generic_0103"), ("no", "usb2_abs_candidate")])
def test_a_better_profile_is_taken_if_the_person_wants_it(lab, answer, base):
    lab.session("", "", answer, profile="usb2_abs_candidate", settings=["simulation.road_encoder=2"])
    lab.procedure.go(only="list")
    lab.procedure.go(only="header")
    config = load_config(profile=str(lab.file))
    assert lab.draft.profile == base
    assert config.board.numbering_pwm == (7 if answer == "yes" else -1)
    assert config.simulation.road_encoder == 2
    assert config.board.logic_version == 0x0103


def test_a_quiet_step_reports_it_and_keeps_the_profile(lab):
    lab.session(profile="usb2_abs_candidate", quiet=True).go()
    assert lab.operator.heard("matching shipped profile is usb2_generic_0103")
    assert lab.draft.profile == "usb2_abs_candidate"


def test_a_board_that_does_not_answer_fails_the_step(lab):
    procedure = lab.session("", "")
    lab.rig.change_answer = lambda answer: answer[:17]
    with pytest.raises(LinkError):
        procedure.go()
    assert lab.outcomes()["header"] == "failed"


def test_a_reading_now_and_then_may_fail(lab, scripts):
    procedure = lab.session(*scripts["list"], *scripts["header"], *scripts["reads"])
    count = iter(range(10_000))
    lab.rig.change_answer = lambda answer: answer[:100] if next(count) % 150 == 149 else answer
    for name in ("list", "header", "reads"):
        procedure.go(only=name)
    assert lab.draft.results["reads"]["failed"] in (6, 7)


def test_too_many_failed_readings_fail_the_step(lab, scripts):
    procedure = lab.session(*scripts["list"], *scripts["header"], *scripts["reads"])
    procedure.go(only="list")
    procedure.go(only="header")
    count = iter(range(10_000))
    lab.rig.change_answer = lambda answer: answer[:100] if next(count) % 20 == 19 else answer
    with pytest.raises(CommissioningError, match="readings failed"):
        procedure.go(only="reads")


def test_a_slow_board_gets_a_rate_that_it_can_keep(lab, scripts):
    procedure = lab.session(*scripts["list"], *scripts["header"], *scripts["reads"])
    procedure.go(only="list")
    procedure.go(only="header")
    lab.rig.before_write = lambda _number: lab.rig.pause(0.002)  # how long each answer takes
    procedure.go(only="reads")
    config = load_config(profile=str(lab.file))
    assert config.loop.rate_hz == 250.0
    assert config.estimator.window_s * config.loop.rate_hz >= 5.0
    assert lab.draft.results["reads"]["times_us"]["p50"] == pytest.approx(2000.0)


@pytest.mark.parametrize(
    ("wanted_hz", "read_us", "kept_hz"), [(2000, 50, 2000), (2000, 300, 1000), (250, 50, 250), (2000, 11_000, 50)]
)
def test_the_rate_is_the_wanted_one_or_the_highest_usual_one_that_fits(wanted_hz, read_us, kept_hz):
    assert kept_rate(wanted_hz, read_us) == kept_hz


def test_a_board_too_slow_for_any_rate_is_refused():
    with pytest.raises(CommissioningError, match="too slow for any rate"):
        kept_rate(2000, 20_000)


def test_a_dump_leaves_out_repeated_lines():
    assert hex_dump(bytes(48) + b"\x12\xab").splitlines() == [
        "  0000  00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00",
        "  0030  12 ab",
    ]


@pytest.fixture
def computer(tmp_path):
    """A computer with one of each board, and other devices."""

    def put(folder, **files):
        (tmp_path / folder).mkdir(parents=True)
        for name, text in files.items():
            (tmp_path / folder / name).write_text(f"{text}\n")

    usb = "sys/bus/usb/devices"
    put(f"{usb}/1-1", idVendor="04b4", idProduct="8613", manufacturer="InTeCo", product="RT-DAC/USB2", serial="77")
    put(f"{usb}/1-2", idVendor="046d", idProduct="c31c", manufacturer="Maker of keyboards")
    put(f"{usb}/1-3", idVendor="0403", idProduct="6001", manufacturer="FTDI", product="FT245R", serial="A9")
    put(f"{usb}/1-3/1-3:1.0/ttyUSB0")
    (tmp_path / "sys/bus/usb-serial/devices").mkdir(parents=True)
    (tmp_path / "sys/bus/usb-serial/devices/ttyUSB0").symlink_to(tmp_path / usb / "1-3/1-3:1.0/ttyUSB0")
    put("sys/bus/pci/devices/0000:03:0a.0", vendor="0x10b5", device="0x2497")
    put("sys/bus/pci/devices/0000:00:1f.0", vendor="0x8086", device="0x2497")
    return Computer(tmp_path)


@pytest.mark.parametrize(
    ("address", "found", "words"),
    [
        ("usb2:", "usb2:77", "04b4:8613 manufacturer 'InTeCo' product 'RT-DAC/USB2' serial '77' at USB port 1-1"),
        ("usb:", "usb:/dev/ttyUSB0", "0403:6001 manufacturer 'FTDI' product 'FT245R' serial 'A9' at USB port 1-3"),
        ("pci:", "pci:0000:03:0a.0", "0x10b5:0x2497 at 0000:03:0a.0"),
    ],
)
def test_boards_are_listed_as_the_kernel_knows_them(computer, address, found, words):
    (one,) = found_devices(address, load_config(), computer)
    assert (one.address, one.description) == (found, words)


def test_no_board_is_said_with_what_to_do(lab):
    procedure = lab.session("")
    lab.rig.devices = lambda _config: []
    with pytest.raises(CommissioningError, match="plug the board in"):
        procedure.go(only="list")


def test_a_logic_without_known_frames_does_not_get_into_the_draft(lab, monkeypatch):
    lab.session("", "").go(only="list")
    opened = lab.rig.open

    def open_known(config):
        if lab.rig.written:
            raise ConfigError([])
        return opened(config)

    before = lab.file.read_text()
    monkeypatch.setattr(lab.rig, "open", open_known)
    with pytest.raises(CommissioningError, match="logic 0x0103 cannot be driven by this version"):
        lab.procedure.go(only="header")
    assert lab.file.read_text() == before
