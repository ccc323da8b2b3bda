import os
import signal
import time

import pytest

import inteco_abs.experiment.virtual_run
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import ReadOnlyError
from inteco_abs.sessions import FileWriter, read_session
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

pytestmark = [pytest.mark.usefixtures("outer_signals"), pytest.mark.untraced]

LONG_S = 1.1
"""Longer than a signal may remain unanswered before another one breaks into the loop."""
RUNNING = [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED]


def sender(*numbers):
    """Sends the signals to this process, one after the other."""

    def send(*_):
        for number in numbers:
            os.kill(os.getpid(), number)

    return send


def check_interrupted(made, devices, replayed):
    stop, session = made.stop, made.session
    assert (stop.outcome, stop.reason, stop.exit_code) == ("interrupted", Reason.OPERATOR_STOP, 130)
    assert stop.explanation == EXPLANATIONS[Reason.OPERATOR_STOP]
    assert session.incomplete == ""
    assert session.metadata["session"]["outcome"] == "interrupted"
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    assert replayed(session).differing == 0
    last = session.ticks[-1]
    assert (last["phase"], last["reason"]) == (Phase.FAULT, Reason.OPERATOR_STOP)
    assert (last["drive"], last["brake"]) == (0.0, 0.0)
    assert last["stop_request"] == Reason.OPERATOR_STOP
    assert not session.ticks["stop_request"][:-1].any()


@pytest.mark.parametrize("phase", RUNNING, ids=lambda phase: phase.name)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_signal_ends_the_run_at_the_next_tick(run, devices, replayed, at_phase, outer_signals, phase, number):
    at_phase(phase, sender(number))
    made = run()
    check_interrupted(made, devices, replayed)
    during = made.session.ticks["phase"] == phase
    assert int(during.sum()) == 1
    assert during[-2]
    assert outer_signals == []


def test_a_terminal_that_hangs_up_ends_the_run(run, devices, replayed, at_phase, outer_signals):
    at_phase(Phase.BRAKING, sender(signal.SIGHUP))
    check_interrupted(run(), devices, replayed)
    assert outer_signals == []


def test_a_signal_during_progress_ends_the_run(run, devices, replayed, outer_signals):
    calls = []

    def progress(phase, ticks):
        calls.append((phase, ticks))
        if len(calls) == 1:
            sender(signal.SIGINT)()

    made = run("experiment.idle_s=1.0", progress=progress)
    check_interrupted(made, devices, replayed)
    assert calls == [(Phase.IDLE, 1000)]
    assert outer_signals == []


def test_a_signal_before_the_first_tick_still_gives_a_whole_file(run, devices, replayed, monkeypatch, outer_signals):
    class Interrupted(FileWriter):
        def begin(self, parameters) -> None:
            super().begin(parameters)
            sender(signal.SIGINT)()

    monkeypatch.setattr(inteco_abs.experiment.virtual_run, "FileWriter", Interrupted)
    made = run()
    check_interrupted(made, devices, replayed)
    assert len(made.session.ticks) == 1
    assert outer_signals == []


def test_a_second_signal_at_once_is_harmless(run, devices, replayed, at_phase, outer_signals):
    at_phase(Phase.BRAKING, sender(signal.SIGINT, signal.SIGINT, signal.SIGTERM))
    check_interrupted(run(), devices, replayed)
    assert outer_signals == []


@pytest.mark.parametrize("patience_s", [0.0, LONG_S], ids=["at once", "late"])
def test_a_second_signal_while_the_file_is_completed_is_harmless(
    run, devices, replayed, at_phase, monkeypatch, outer_signals, patience_s
):
    class Interrupted(FileWriter):
        def ticks(self, records) -> None:
            time.sleep(patience_s)
            sender(signal.SIGINT)()
            super().ticks(records)

        def finish(self, *args) -> None:
            sender(signal.SIGTERM)()
            super().finish(*args)
            sender(signal.SIGINT)()

    monkeypatch.setattr(inteco_abs.experiment.virtual_run, "FileWriter", Interrupted)
    at_phase(Phase.IDLE, sender(signal.SIGINT))
    check_interrupted(run(), devices, replayed)
    assert outer_signals == []


@pytest.mark.parametrize("patience_s", [0.0, LONG_S], ids=["at once", "late"])
def test_a_second_signal_while_the_outputs_are_made_safe_does_not_keep_them_on(
    run, devices, replayed, at_phase, monkeypatch, outer_signals, patience_s
):
    class Interrupted(RtdacUsb2):
        def make_safe(self) -> None:
            time.sleep(patience_s)
            sender(signal.SIGINT, signal.SIGTERM)()
            super().make_safe()

    monkeypatch.setattr(
        inteco_abs.experiment.virtual_run,
        "board_behind",
        lambda link, config, now_ns: Interrupted(link, config.board, now_ns, config.period_ns),
    )
    at_phase(Phase.BRAKING, sender(signal.SIGINT))
    check_interrupted(run(), devices, replayed)
    assert outer_signals == []


class Hanging:
    """Controller that never returns, with an operator who asks, waits and asks again."""

    gains = ()
    internals = ()

    def __init__(self, _setup) -> None:
        pass

    def update(self, _estimate, _dt_s):
        while True:
            sender(signal.SIGINT)()
            time.sleep(LONG_S)


def test_a_second_late_signal_breaks_into_a_controller_that_never_returns(
    run, devices, replayed, tmp_path, outer_signals
):
    controllers = {**CONTROLLERS, "hanging": Hanging}
    with pytest.raises(KeyboardInterrupt):
        run("controller.name=hanging", controllers=controllers)
    assert [device.duties for device in devices] == [(0.0, 0.0)]
    session = read_session(tmp_path / "stop.mcap")
    assert session.incomplete == ""
    assert session.metadata["session"]["outcome"] == "aborted"
    assert session.ticks["phase"][-1] == Phase.BRAKING
    assert replayed(session, controllers).differing == 0
    assert outer_signals == []


def test_a_signal_after_the_last_tick_keeps_the_session(run, monkeypatch, outer_signals):
    class Interrupted(FileWriter):
        def finish(self, *args) -> None:
            sender(signal.SIGINT)()
            super().finish(*args)

    monkeypatch.setattr(inteco_abs.experiment.virtual_run, "FileWriter", Interrupted)
    made = run()
    assert made.stop.outcome == made.session.metadata["session"]["outcome"] == "completed"
    assert outer_signals == []


def test_before_and_after_a_run_signals_go_where_they_went_before(run, outer_signals):
    sender(signal.SIGTERM)()
    run()
    sender(signal.SIGINT)()
    assert outer_signals == [signal.SIGTERM, signal.SIGINT]


def test_handlers_are_restored_after_a_run_that_could_not_start(run, outer_signals):
    with pytest.raises(ReadOnlyError):
        run("board.verified_by=''")
    sender(signal.SIGINT)()
    assert outer_signals == [signal.SIGINT]


def test_handlers_are_restored_after_a_run_that_broke_off(run, outer_signals):
    def progress(*_):
        raise RuntimeError("the screen is gone")

    with pytest.raises(RuntimeError):
        run(progress=progress)
    sender(signal.SIGINT)()
    assert outer_signals == [signal.SIGINT]
