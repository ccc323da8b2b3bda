import errno
import math
import os
import resource
import shutil
from functools import partial

import pytest

import inteco_abs.experiment.virtual_run
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import AbsError, BoardError, ConfigError, ReadOnlyError, SessionError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.realtime import memory
from inteco_abs.realtime.processes.recorder import recover_run
from inteco_abs.sessions import FileWriter, changes_among, file_writer, read_session
from inteco_abs.signals import EXPLANATIONS, BrakeDemand, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


class Broken:
    """Controller that raises at its tenth update."""

    gains = ()
    internals = ()

    def __init__(self, _setup) -> None:
        self._left = 10

    def update(self, estimate, dt_s):
        self._left -= 1
        if not self._left:
            raise ZeroDivisionError(f"slip {estimate.slip:.1f} after {dt_s} s")
        return BrakeDemand(0.5)


class NotANumber(Broken):
    """Controller that asks for NaN."""

    def update(self, _estimate, _dt_s):
        return BrakeDemand(math.nan)


class Unbuildable(Broken):
    """Controller whose constructor raises."""

    def __init__(self, _setup) -> None:
        raise ValueError("no such table")


@pytest.fixture
def run(run):
    """With the tracer on: what a run does in trouble is tested here and nowhere else."""
    return partial(run, traced=True)


def mine(kind):
    return {**CONTROLLERS, "mine": kind}


def run_mine(run, kind):
    return run("controller.name=mine", controllers=mine(kind))


def test_a_controller_that_raises_ends_in_a_fault_with_its_words(run, devices, replayed):
    made = run_mine(run, Broken)
    stop, session = made.stop, made.session
    assert (stop.outcome, stop.reason, stop.exit_code) == ("fault", Reason.CONTROLLER_ERROR, 5)
    assert stop.explanation.startswith(f"{EXPLANATIONS[Reason.CONTROLLER_ERROR]}: ZeroDivisionError: slip 0.")
    assert "after 0.0005 s (test_experiment_failures.py, line " in stop.explanation
    assert (session.incomplete, session.metadata["session"]["reason"]) == ("", stop.explanation)
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    last = session.ticks[-1]
    assert (last["phase"], last["reason"]) == (Phase.FAULT, Reason.CONTROLLER_ERROR)
    assert (last["drive"], last["brake"]) == (0.0, 0.0)
    assert session.ticks["brake"][-2] == 0.5
    assert replayed(session, mine(Broken)).differing == 0


def test_a_controller_that_asks_for_nan_ends_in_a_fault(run, devices, replayed):
    made = run_mine(run, NotANumber)
    assert (made.stop.outcome, made.stop.reason) == ("fault", Reason.BAD_OUTPUT)
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    assert made.session.ticks["brake"].max() == 0.0
    assert math.isnan(made.session.ticks["brake_request"][-1])
    assert replayed(made.session, mine(NotANumber)).differing == 0


def test_a_controller_that_cannot_be_built_leaves_no_file(run, tmp_path):
    with pytest.raises(ConfigError, match=r"controller\.name: mine cannot be made: ValueError: no such table"):
        run_mine(run, Unbuildable)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["profile=usb2_generic_0103"], "the board's logic is named 'ABSSIM', the profile knows none yet"),
        (["board.application_names=['ABS2']"], "the board's logic is named 'ABSSIM', the profile knows 'ABS2'"),
        (["board.logic_version=258"], "the board has logic 0x0103, the profile was made for 0x0102"),
        (["board.verified_by=''"], "the profile's wiring was not verified"),
    ],
    ids=["generic", "name", "version", "unsigned"],
)
def test_a_board_that_the_profile_does_not_know_leaves_no_file(tmp_path, devices, settings, words):
    with pytest.raises(ReadOnlyError) as refusal:
        run_stop(load_config(settings=settings), Plan(out=tmp_path / "stop.mcap"))
    assert words in str(refusal.value)
    assert list(tmp_path.iterdir()) == []
    (device,) = devices
    assert device.settings == {}  # nothing was written


@pytest.mark.parametrize("address", ["usb:ttyUSB0", "usb3:", "sim", "", "sim:1"])
def test_an_unknown_address_leaves_no_file(tmp_path, devices, address):
    with pytest.raises(ConfigError, match="--board"):
        run_stop(load_config(), Plan(out=tmp_path / "stop.mcap", board=address))
    assert list(tmp_path.iterdir()) == []
    assert devices == []


def test_an_existing_session_is_left_alone_and_the_board_too(run, devices, tmp_path):
    path = tmp_path / "stop.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(ConfigError, match="never overwritten"):
        run()
    assert path.read_bytes() == b"precious"
    assert devices == []


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_interrupted_run_leaves_the_board_safe_and_the_file_whole(run, devices, replayed, tmp_path, kind):
    def progress(phase, _ticks):
        if phase is Phase.BRAKING:
            raise kind("the screen is gone")

    with pytest.raises(kind, match="the screen is gone"):
        run(progress=progress)
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    session = read_session(tmp_path / "stop.mcap")
    assert session.incomplete == ""
    facts = session.metadata["session"]
    assert facts["outcome"] == "aborted"
    assert facts["reason"].startswith(f"{kind.__name__}: the screen is gone")
    assert session.ticks["phase"][-1] == Phase.BRAKING
    assert len(session.truth) == len(session.ticks) + 1  # the write that made it safe
    assert replayed(session).differing == 0


@pytest.fixture
def stuck(monkeypatch):
    """A board that does not confirm SAFE."""

    class Stuck(RtdacUsb2):
        def make_safe(self) -> None:
            raise BoardError("SAFE could not be confirmed")

    monkeypatch.setattr(
        inteco_abs.experiment.virtual_run,
        "board_behind",
        lambda link, config, now_ns: Stuck(link, config.board, now_ns, config.period_ns),
    )


@pytest.mark.usefixtures("stuck")
def test_a_board_that_cannot_be_made_safe_is_said_and_no_tick_is_lost(run, quick, tmp_path):
    with pytest.raises(BoardError, match="SAFE could not be confirmed"):
        run()
    session = read_session(tmp_path / "stop.mcap")
    assert session.incomplete == ""
    assert session.metadata["session"]["outcome"] == "aborted"
    assert len(session.ticks) == quick.stop.card["ticks"]
    assert session.payload == quick.session.payload


@pytest.mark.usefixtures("stuck")
def test_a_board_that_cannot_be_made_safe_is_said_even_when_the_disk_is_full(run, room):
    room(100_000)
    with pytest.raises(BoardError, match="SAFE could not be confirmed"):
        run("experiment.start_speed_rad_s=60.0")


def test_full_disk_leaves_the_board_safe_and_the_file_readable(run, devices, room, tmp_path):
    room(100_000)
    with pytest.raises(SessionError, match=os.strerror(errno.EFBIG)):
        run("experiment.start_speed_rad_s=60.0")
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    session = read_session(tmp_path / "stop.mcap")
    assert session.incomplete
    assert "config.toml" in session.attachments


def test_a_disk_that_is_full_from_the_start_leaves_no_file_and_nothing_moves(run, devices, room, tmp_path):
    room(0)
    with pytest.raises(SessionError, match=os.strerror(errno.EFBIG)):
        run()
    assert list(tmp_path.iterdir()) == []
    (device,) = devices
    assert (device.duties, device.plant.road_speed) == ((0.0, 0.0), 0.0)


def test_a_failure_before_the_first_tick_leaves_no_file(run, devices, monkeypatch, tmp_path):
    class Failing(FileWriter):
        def begin(self, _parameters) -> None:
            raise SessionError("no room")

    monkeypatch.setattr(inteco_abs.experiment.virtual_run, "FileWriter", Failing)
    with pytest.raises(AbsError, match="no room"):
        run()
    assert list(tmp_path.iterdir()) == []
    assert [device.duties for device in devices] == [(0.0, 0.0)]


def test_session_moves_to_the_second_place_when_its_folder_vanishes(run, quick, devices, vanishing, replayed, tmp_path):
    (tmp_path / "spill").mkdir()
    made = run(f"session.spill={tmp_path / 'spill'}", name=vanishing)
    assert (made.stop.outcome, made.stop.exit_code) == ("completed", 3)
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    session = read_session(tmp_path / "spill" / "stop.mcap")
    assert made.stop.card["session"] == str(session.path)
    assert not session.incomplete
    assert session.payload == quick.session.payload
    assert replayed(session).differing == 0


def test_a_run_that_no_disk_takes_is_recovered_from_memory(run, quick, vanishing, replayed, monkeypatch, tmp_path):
    (tmp_path / "memory").mkdir()
    monkeypatch.setattr(memory, "FOLDER", tmp_path / "memory")
    with pytest.raises(SessionError, match=r"is gone.*Its ticks are kept in .*: inteco-abs recover ") as refusal:
        run('experiment.changes=["reference_slip=0.2@brake"]', name=vanishing)  # the same slip as without
    assert refusal.value.exit_code == 3
    (ring,) = memory.left_rings(tmp_path / "memory")
    assert f"inteco-abs recover {ring} --out FILE" in str(refusal.value)
    account = recover_run(ring, tmp_path / "saved.mcap")
    assert (account.outcome, account.card["lost_ticks"]) == ("completed", 0)
    session = read_session(tmp_path / "saved.mcap")
    assert session.payload == quick.session.payload
    assert len(session.truth) == len(quick.session.truth)
    assert session.metadata["rig"]["virtual_time"] == "true"
    assert session.attachments.keys() == quick.session.attachments.keys()
    assert [(each.name, each.value) for each in changes_among(session.parameters)] == [("reference_slip", 0.2)]
    assert replayed(session).differing == 0
    assert not ring.exists()


def test_an_aborted_run_without_a_disk_is_aborted_when_it_is_recovered(run, vanishing, monkeypatch, tmp_path):
    (tmp_path / "memory").mkdir()
    monkeypatch.setattr(memory, "FOLDER", tmp_path / "memory")

    def progress(phase, _ticks):
        if phase is Phase.BRAKING:
            raise RuntimeError("the screen is gone")

    with pytest.raises(RuntimeError, match="the screen is gone"):
        run(name=vanishing, progress=progress)
    (ring,) = memory.left_rings(tmp_path / "memory")
    recover_run(ring, tmp_path / "saved.mcap")
    facts = read_session(tmp_path / "saved.mcap").metadata["session"]
    assert (facts["outcome"], facts["reason"][:12]) == ("aborted", "RuntimeError")


class TestLongerThanItsMemory:
    """Runs of which memory holds only the newest part when a disk begins to refuse."""

    LONG = (
        "experiment.start_speed_rad_s=60.0",
        "experiment.idle_s=0.02",
        "experiment.hold_s=0.05",
        "experiment.stops=6",
        "loop.ring_s=4.0",
    )
    LATE = 12_000
    """Ticks: more than memory has room for."""

    @pytest.fixture
    def undisturbed(self, run):
        return run(*self.LONG, name="undisturbed.mcap").stop.card

    @pytest.fixture
    def disturbed(self, run, tmp_path):
        """Runs to out/stop.mcap, and has something happen late."""
        (tmp_path / "out").mkdir()

        def disturb(*settings, by):
            pending = [by]

            def progress(_phase, ticks):
                if ticks > self.LATE and pending:
                    pending.pop()()

            return run(*self.LONG, *settings, name="out/stop.mcap", progress=progress)

        return disturb

    @pytest.mark.long
    def test_the_second_file_has_what_the_first_had_though_that_has_lost_its_name(
        self, disturbed, undisturbed, tmp_path
    ):
        (tmp_path / "spill").mkdir()
        settings = (f"session.spill={tmp_path / 'spill'}",)
        stop = disturbed(*settings, by=lambda: shutil.rmtree(tmp_path / "out")).stop
        session = read_session(tmp_path / "spill" / "stop.mcap")
        assert (stop.card, stop.exit_code) == (undisturbed | {"session": str(session.path)}, 3)
        assert (session.incomplete, len(session.truth)) == ("", stop.card["ticks"] + 1)
        assert "the whole session is in" in stop.trouble

    @pytest.mark.long
    def test_without_a_second_place_it_ends_in_order_before_memory_is_full(self, disturbed, devices, tmp_path, rings):
        with pytest.raises(SessionError, match="Its ticks are kept in") as refusal:
            disturbed(by=lambda: shutil.rmtree(tmp_path / "out"))
        assert refusal.value.exit_code == 5
        assert [device.duties for device in devices] == [(0.0, 0.0)]
        account = recover_run(rings(), tmp_path / "saved.mcap")
        assert (account.outcome, account.reason) == ("fault", Reason.RECORDER_LOST)
        session = read_session(tmp_path / "saved.mcap")
        first = int(session.ticks["tick"][0])
        assert 0 < first <= self.LATE
        assert account.card["lost_ticks"] == first
        assert (
            f"those before tick {first} were in {tmp_path / 'out' / 'stop.mcap'}, which is missing"
            in account.explanation
        )
        assert session.ticks["tick"].tolist() == list(range(first, first + account.card["ticks"]))

    @pytest.mark.long
    def test_what_a_full_disk_has_and_what_memory_has_make_one_session(
        self, disturbed, monkeypatch, tmp_path, rings, replayed
    ):
        def refuse(_file, _data):
            raise SessionError("no space left")

        with monkeypatch.context() as patch, pytest.raises(SessionError, match="Its ticks are kept in"):
            disturbed(by=lambda: patch.setattr(file_writer.Disk, "write", refuse))
        account = recover_run(rings(), tmp_path / "saved.mcap")
        session = read_session(tmp_path / "saved.mcap")
        assert (account.reason, account.card["lost_ticks"]) == (Reason.RECORDER_LOST, 0)
        assert session.ticks["tick"].tolist() == list(range(account.card["ticks"]))
        assert len(session.ticks) > self.LATE
        assert replayed(session).differing == 0

    @pytest.fixture
    def rings(self, monkeypatch, tmp_path):
        """The one memory that a run has left."""
        (tmp_path / "memory").mkdir()
        monkeypatch.setattr(memory, "FOLDER", tmp_path / "memory")
        return lambda: next(memory.left_rings(tmp_path / "memory"))


def test_a_session_that_did_not_end_well_says_after_which_tick(run, quick, tmp_path):
    def progress(phase, _ticks):
        if phase is Phase.BRAKING:
            raise RuntimeError("the screen is gone")

    with pytest.raises(RuntimeError):
        run(progress=progress)
    session = read_session(tmp_path / "stop.mcap")
    assert session.metadata["session"]["last_tick"] == str(session.ticks["tick"][-1])
    assert "died" not in session.metadata["session"]
    assert "last_tick" not in quick.session.metadata["session"]


@pytest.fixture
def lifted(room):
    """After the test, when pytest reports its end, the disk is no longer full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield room
    assert resource.getrlimit(resource.RLIMIT_FSIZE) == before


def test_a_disk_that_is_full_for_a_test_is_not_full_for_what_pytest_writes_of_it(lifted, tmp_path):
    lifted(0)
    with pytest.raises(OSError, match="File too large"):
        (tmp_path / "file").write_bytes(b"x")
