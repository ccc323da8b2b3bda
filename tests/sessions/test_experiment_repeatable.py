import hashlib
import threading

import pytest

from inteco_abs.sessions import RunResult
from inteco_abs.signals import Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PACED = ("loop.rate_hz=200.0", "experiment.start_speed_rad_s=10.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0")


def test_the_same_seed_gives_the_same_payload(run, quick):
    again = run(name="again.mcap", seed=1)
    assert again.session.payload == quick.session.payload
    assert again.session.truth.tobytes() == quick.session.truth.tobytes()
    assert again.stop.card["payload_sha256"] == quick.stop.card["payload_sha256"]


def test_the_board_on_the_pci_bus_gives_the_payload_of_the_one_on_usb(run, quick):
    pci = run("profile=sim_pci", name="pci.mcap", seed=1)
    assert pci.session.payload == quick.session.payload
    assert pci.session.truth.tobytes() == quick.session.truth.tobytes()


def test_another_seed_gives_another_payload(run, quick):
    hashes = {run(name=f"{seed}.mcap", seed=seed).stop.card["payload_sha256"] for seed in range(4)}
    assert len(hashes) == 4
    assert quick.stop.card["payload_sha256"] in hashes


def test_two_runs_are_two_sessions(run, quick):
    again = run(name="again.mcap", seed=1)
    first, second = (made.session.metadata["session"]["session_id"] for made in (quick, again))
    assert first != second


def test_hash_on_the_card_is_that_of_the_ticks_in_the_file(quick):
    assert quick.stop.card["payload_sha256"] == hashlib.sha256(quick.session.payload).hexdigest()


def test_a_completed_run(quick):
    assert (quick.stop.outcome, quick.stop.reason, quick.stop.explanation) == ("completed", Reason.NONE, "no fault")
    assert quick.stop.exit_code == 0
    assert quick.session.ticks["phase"][-1] == Phase.DONE
    assert quick.session.ticks["brake"][-1] == quick.session.ticks["drive"][-1] == 0.0


def test_the_board_is_safe_after_a_completed_run(run, devices):
    run()
    (device,) = devices
    assert device.duties == (0.0, 0.0)
    assert device.settings["pwm0_width"] == device.settings["pwm1_width"] == 0


def test_progress_is_reported_in_order(run, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")  # machine code, if there is any yet, reports each 4,000 ticks
    calls = []
    made = run("experiment.idle_s=1.0", progress=lambda phase, ticks: calls.append((phase, ticks)))
    phases, ticks = zip(*calls, strict=True)
    assert list(phases) == sorted(phases)
    assert list(ticks) == sorted(set(ticks))
    assert {Phase.IDLE, Phase.ARMED, Phase.BRAKING} <= set(phases)
    assert 0 < made.stop.card["ticks"] - ticks[-1] <= 1000


def test_progress_changes_nothing(run, quick):
    assert run(progress=lambda *_: None).session.payload == quick.session.payload


def test_a_run_in_another_thread_needs_no_signals(run, quick, outer_signals):
    made = []
    thread = threading.Thread(target=lambda: made.append(run()))
    thread.start()
    thread.join()
    assert made[0].session.payload == quick.session.payload
    assert outer_signals == []


@pytest.mark.long  # as runs of the command do
def test_a_run_in_real_time_replays_bit_for_bit(tmp_path, run_at, replayed):
    made = run_at(tmp_path / "stop.mcap", PACED, virtual=False)
    session = made.session
    assert session.incomplete == ""
    assert session.metadata["rig"]["virtual_time"] == "false"
    assert session.metadata["session"]["outcome"] == made.stop.outcome
    assert session.ticks["io_us"].min() > 0.0
    found = replayed(session)
    assert (found.ticks, found.differing) == (made.stop.card["ticks"], 0)


@pytest.mark.parametrize(
    ("outcome", "overruns", "link_errors", "lost_ticks", "code"),
    [
        ("completed", 0, 0, 0, 0),
        ("completed", 1, 0, 0, 3),
        ("completed", 0, 1, 0, 3),
        ("completed", 0, 0, 1, 3),
        ("fault", 1, 1, 1, 5),
        ("fault", 0, 0, 0, 5),
        ("aborted", 0, 0, 0, 5),
        ("interrupted", 0, 0, 0, 130),
        ("interrupted", 7, 0, 0, 130),
    ],
)
def test_exit_code(outcome, overruns, link_errors, lost_ticks, code):
    card = {"overruns": overruns, "link_errors": link_errors, "lost_ticks": lost_ticks}
    assert RunResult(outcome, Reason.NONE, "", card).exit_code == code
