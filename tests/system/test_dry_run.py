"""`--dry-run` of everything that moves hardware: what would be done, all that stands against it, and nothing done."""

import json
from types import SimpleNamespace

import pytest

from inteco_abs.commissioning import STEPS, MockRigAccess
from inteco_abs.config import load_config
from inteco_abs.identification import experiments
from inteco_abs.realtime import memory

VIRTUAL = ("run", "--virtual", "--dry-run")
UNTRUSTED = ("--set", "profile=usb2_generic_0103")


@pytest.fixture
def dry_run(main_here):
    """The report of a dry run."""

    def run(*arguments, check=0):
        return json.loads(main_here(*arguments, "--json", check=check).stdout)

    return run


def test_a_run_that_would_begin_prints_its_phases_and_leaves_no_file(main_here, tmp_path):
    text = " ".join(main_here(*VIRTUAL, check=0).stdout.split())
    assert "SPIN_UP at most 20 s: drive 1 until the road wheel turns at 180 rad/s" in text
    assert "reaching-law on moving-window, reference slip 0.2, brake at most 1" in text
    assert "sim: logic 0x0103 'ABSSIM' of 20260101: outputs may be used" in text
    assert "session sessions/stop-" in text
    assert text.endswith("It would begin. This was a dry run: no output or setting was written, and nothing to a disk.")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("profile", "place"), [("sim_usb2", "w20"), ("sim_usb", "b21"), ("sim_pci", "0x68")])
def test_the_changes_of_the_first_write_are_listed_word_by_word(dry_run, profile, place):
    words = dry_run(*VIRTUAL, "--set", f"profile={profile}")["board"]["first_write"]
    prescaler = next(one for one in words if one["names"] == ["pwm0_prescaler"])
    assert prescaler == {"place": place, "names": ["pwm0_prescaler"], "now": 0, "planned": 44, "remark": ""}


def test_a_run_in_real_time_reports_memory_and_computer_and_takes_no_memory(dry_run, tmp_path):
    before = set(memory.FOLDER.glob("*"))
    report = dry_run("run", "--dry-run")
    disk, shared = report["needs"]
    assert shared["what"] == "shared memory"
    assert shared["bytes"] > report["runs"][0]["most_ticks"] * 250
    assert disk["bytes"] > report["runs"][0]["most_ticks"] * 250
    assert report["computer"]["verdict"] in {"green", "amber", "red"}
    assert report["longest_s"] == load_config().experiment.longest_s
    assert set(memory.FOLDER.glob("*")) <= before
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("profile", ["sim_usb2", "sim_usb", "sim_pci"])
def test_no_message_to_a_board_of_any_kind_writes_a_setting(main_here, monkeypatch, profile):
    benches = []

    class Kept(MockRigAccess):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            self.device.settings = Untouched(self.device.settings)
            benches.append(self)

    monkeypatch.setattr("inteco_abs.commissioning.MockRigAccess", Kept)
    main_here(*VIRTUAL, "--set", f"profile={profile}", check=0)
    (bench,) = benches
    assert bench.device.settings.written == set()


class Untouched(dict):
    """Settings of a device; returns those that were written."""

    def __init__(self, settings):
        super().__init__(settings)
        self.written = set()

    def __setitem__(self, name, value):
        self.written.add(name)
        super().__setitem__(name, value)

    def update(self, *arguments, **values):
        self.written |= dict(*arguments, **values).keys()
        super().update(*arguments, **values)


def test_everything_that_would_be_refused_is_listed_at_once(dry_run, tmp_path):
    (tmp_path / "there.mcap").write_bytes(b"")
    (tmp_path / "there.jsonl").write_bytes(b"")
    files = ("--out", "there.mcap", "--figure", "stop.bmp", "--record-wire", "there.jsonl")
    report = dry_run(*VIRTUAL, *UNTRUSTED, *files, "--foxglove", "--set", "session.spill=nowhere", check=2)
    assert not report["would_begin"]
    assert {one["where"] for one in report["refused"]} == {"--out", "--figure", "--foxglove", "session.spill", ""}
    others = [one["problem"] for one in report["refused"] if not one["where"]]
    assert any("there.jsonl: exists already" in text for text in others)
    assert any("opens for reading only" in text for text in others)
    assert {path.name for path in tmp_path.iterdir()} == {"there.mcap", "there.jsonl"}


REFUSED = {
    "an unsigned profile": (UNTRUSTED, 1),
    "a real board in virtual time": (("--board", "usb:/dev/nowhere"), 2),
    "no second place": (("--set", "session.spill=nowhere"), 2),
    "a capture of a board on the bus": (("--set", "profile=sim_pci", "--frames"), 2),
    "no folder": (("--out", "nowhere/stop.mcap"), 2),
    "another suffix": (("--out", "stop.bag"), 2),
    "one file for two": (("--out", "stop.mcap", "--record-wire", "stop.mcap"), 2),
}


@pytest.mark.parametrize("arguments", REFUSED.values(), ids=REFUSED)
def test_what_it_refuses_a_run_refuses_with_the_same_words_and_exit_code(main_here, dry_run, arguments):
    options, code = arguments
    run = main_here("run", "--virtual", *options, check=code)
    report = dry_run(*VIRTUAL, *options, check=code)
    assert any(one["problem"] in run.stderr for one in report["refused"])


def test_a_wrong_configuration_is_reported_as_json_with_file_and_line(dry_run, tmp_path):
    (tmp_path / "rig.toml").write_text("[guard]\nbrake_limit = 7.0\n")
    for verb in (["run"], ["repeat", "2"]):
        report = dry_run(*verb, "--virtual", "--dry-run", "--config", "rig.toml", "--figure", "stop.bmp", check=2)
        assert report["would_begin"] is False
        assert {one["where"]: one["place"] for one in report["refused"]} == {
            "--figure": "",
            "guard.brake_limit": "rig.toml, line 2",
        }


@pytest.mark.parametrize("board", ["usb:/dev/nowhere", "pci:0000:7f:1f.7"])
def test_a_board_that_is_not_there_is_refused_as_by_a_run(dry_run, tmp_path, board):
    report = dry_run("run", "--board", board, "--dry-run", check=1)
    assert report["board"]["identity"] is None
    assert len(report["refused"]) == 1
    assert list(tmp_path.iterdir()) == []


REFUSES = """
class Law:
    gains = internals = ()
    def __init__(self, setup):
        print("hello")
        raise ValueError("no")
    def update(self, estimate, dt_s): ...
"""


def test_controller_that_cannot_be_made_is_refused_without_its_prints(dry_run, tmp_path):
    (tmp_path / "law.py").write_text(REFUSES)
    report = dry_run(*VIRTUAL, "--controller", "law.py:Law", check=2)
    assert "cannot be made: ValueError: no" in report["refused"][0]["problem"]
    assert [path.name for path in tmp_path.iterdir()] == ["law.py"]


def test_mistakes_in_the_configuration_come_with_those_on_the_command_line(main_here):
    run = main_here(*VIRTUAL, "--set", "guard.brake_limit=7", "--figure", "stop.bmp", check=2)
    assert "has 2 mistakes" in run.stderr
    assert "guard.brake_limit: 7" in run.stderr
    assert "--figure" in run.stderr


def test_too_little_memory_is_refused(dry_run, monkeypatch):
    monkeypatch.setattr(memory.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=1_000_000))
    (refused,) = dry_run("run", "--dry-run", check=1)["refused"]
    assert "of shared memory in /dev/shm: 1 MB are free; free some, or set loop.ring_s to less" in refused["problem"]


def test_a_disk_without_room_for_the_whole_session_is_noted(dry_run, monkeypatch):
    monkeypatch.setattr(memory.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=1_000_000))
    assert "stay in memory and must be recovered" in dry_run(*VIRTUAL)["cautions"][0]


def test_a_duty_that_the_guard_cuts_is_noted(dry_run):
    report = dry_run(*VIRTUAL, "--set", "guard.drive_limit=0.5")
    assert "guard.drive_limit, which cuts it to 0.5" in report["cautions"][0]


def test_faults_to_be_injected_are_listed_and_do_not_act(dry_run):
    report = dry_run(*VIRTUAL, "--inject", "unplug@brake")
    assert "checked without faults; the run injects unplug@brake" in report["cautions"][0]


def test_a_series_lists_all_its_stops_with_their_pauses(dry_run, main_here, tmp_path):
    report = dry_run("repeat", 3, "--virtual", "--dry-run", "--pause", 10, "-o", "series")
    (run,) = report["runs"]
    assert (run["times"], run["session"]) == (3, "series/stop-1.mcap")
    assert report["longest_s"] == 3 * run["longest_s"] + 20.0
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "series").mkdir()
    text = " ".join(main_here("repeat", 3, "--virtual", "--dry-run", "-o", "series", check=2).stdout.split())
    assert "--out: series: exists already; name a folder that does not exist" in text


def test_the_plan_of_an_identification_lists_every_existing_session(dry_run, tmp_path):
    plan = ("identify", "--plan", "--virtual", "--dry-run")
    assert [run["session"] for run in dry_run(*plan)["runs"]][:2] == [
        "identification/coast.mcap",
        "identification/stair.mcap",
    ]
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "identification").mkdir()
    for name in ("stair", "stop-060"):
        (tmp_path / "identification" / f"{name}.mcap").write_bytes(b"")
    refused = [one["problem"] for one in dry_run(*plan, check=2)["refused"]]
    assert [text.partition(".mcap")[0] for text in refused] == ["identification/stair", "identification/stop-060"]


def test_a_plan_is_printed_run_by_run(main_here):
    text = " ".join(main_here("identify", "--plan", "--virtual", "--dry-run", check=0).stdout.split())
    for each in experiments(load_config().guard.brake_limit):
        assert f"identification/{each.name}.mcap {each.shows};" in text


def test_sessions_that_are_only_read_need_no_dry_run(main_here):
    assert "only with --plan" in main_here("identify", "a.mcap", "--dry-run", check=2).stderr


def test_a_panel_reports_whether_it_would_begin(main_here):
    run = main_here("panel", "--outputs", "--dry-run", check=1)
    text = " ".join(run.stdout.split())
    assert "brake at most 1, drive at most 1" in text
    assert "outputs may be used" in text
    assert "refused the panel needs a terminal" in text
    assert "the panel only reads" in main_here("panel", "--dry-run", check=2).stderr


def test_commissioning_lists_its_steps_and_begins_no_draft(main_here, dry_run, tmp_path):
    text = main_here("commission", "--dry-run", check=0).stdout
    for step in STEPS:
        assert step.risk in text
    assert [step["name"] for step in dry_run("commission", "--dry-run")["steps"]] == [step.name for step in STEPS]
    assert list(tmp_path.iterdir()) == []
