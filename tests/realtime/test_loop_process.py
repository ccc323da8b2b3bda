"""What the loop's process leaves for the others, in this process."""

import os
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.control import CONTROLLERS, gains_in_force
from inteco_abs.errors import UnsafeError
from inteco_abs.mock_board import Device, front_end_of
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.processes import loop as rt
from inteco_abs.realtime.tuning import Setting
from inteco_abs.sessions import TICK
from inteco_abs.signals import Reason

SETTING = Setting("scheduler", "SCHED_FIFO 80")
PACE = {"exchanges": "quick enough"}
BEFORE = SimpleNamespace(ru_utime=10.0, ru_stime=1.0, ru_minflt=100, ru_majflt=7)
AFTER = SimpleNamespace(ru_utime=10.5, ru_stime=1.25, ru_minflt=103, ru_majflt=8)
TOOK_S = 2.0


class Process:
    """The loop's process in this one, guarded and stopped at its first tick."""

    def __init__(self, memory, job, monkeypatch):
        self.memory, self.job, self.words = memory, job, memory.words
        self.words[Field.SUPERVISOR_PID] = self.words[Field.GUARDING_PID] = os.getpid()
        self.words[Field.STOP], self.words[Field.GO] = Reason.OPERATOR_STOP, 1
        face = front_end_of(Device(job.config, rt.time.monotonic_ns, 1))
        self.codes, self.tunings, self.rates = [], [], []
        costs, times = iter([BEFORE, AFTER]), iter([50.0, 50.0 + TOOK_S])
        usage = SimpleNamespace(getrusage=lambda _who: next(costs), RUSAGE_SELF=0)
        clock = SimpleNamespace(**{**vars(rt.time), "monotonic": lambda: next(times)})
        monkeypatch.setattr(
            rt,
            "open_board",
            lambda _address, config, now_ns, around: board_behind(around(InProcessLink(face)), config, now_ns),
        )
        monkeypatch.setattr(rt, "resource", usage)
        monkeypatch.setattr(rt, "time", clock)
        monkeypatch.setattr(rt, "loop_tuning", lambda: "the loop's")
        monkeypatch.setattr(rt, "apply", lambda tunings: self.tunings.append(tunings) or [SETTING])
        monkeypatch.setattr(rt, "require_rate", lambda _board, period_ns: self.rates.append(period_ns) or PACE)
        monkeypatch.setattr(rt.os, "_exit", self.codes.append)

    def run(self):
        """Its exit code."""
        self.job.post(self.memory)
        rt.main(str(self.memory.path))
        (code,) = self.codes
        return code


@pytest.fixture
def process(memory, job_of, monkeypatch):
    return Process(memory, job_of(memory), monkeypatch)


def test_before_the_first_tick_it_introduces_itself_and_at_the_end_it_concludes(process):
    assert process.run() == 0
    config = process.job.config
    posted = process.memory.note(Mailbox.HEADER)
    assert posted["identity"]["application_name"] == "ABSSIM"
    assert posted["gains"] == gains_in_force(config)
    law = CONTROLLERS[config.controller.name]
    assert posted["internals"] == [list(each) for each in law.internals]
    assert posted["declared"] == [[gain.name, gain.unit, gain.meaning] for gain in law.gains]
    assert (posted["settings"], posted["pace"]) == ([SETTING._asdict()], {})
    assert process.memory.image(Mailbox.SAFE_IMAGE)
    assert process.tunings == ["the loop's"]
    end = process.memory.note(Mailbox.RUN_END)
    assert (end["reason"], end["detail"]) == (Reason.OPERATOR_STOP, "")
    assert int(end["cost"].pop("spin_us")) in range(10, 10_000)
    cost = {"minor_page_faults": "3", "major_page_faults": "1", "cpu_share": "0.375", "decisions": "Python"}
    assert end["cost"] == cost
    assert process.words[Field.READY] == os.getpid()
    assert process.words[Field.HOLDER_PID] == process.words[Field.SAVING] == 0
    assert process.memory.note(Mailbox.FAILURE) is None
    assert TICK.array(process.memory.tick_reader().take())["stop_request"].tolist()[:1] == [Reason.OPERATOR_STOP]


def test_a_stop_before_the_start_allows_no_tick(process):
    process.words[Field.GO] = 0
    assert process.run() == 0
    assert process.memory.note(Mailbox.HEADER)
    assert process.memory.note(Mailbox.RUN_END) is None
    assert process.memory.tick_reader().written == 0


def test_it_waits_until_it_may_begin(process):
    def let_go():
        while process.words[Field.READY] != os.getpid():
            time.sleep(0.001)
        process.words[Field.GO] = 1
        process.words[Field.STOP] = Reason.OPERATOR_STOP

    process.words[Field.GO] = process.words[Field.STOP] = 0
    supervisor = threading.Thread(target=let_go)
    supervisor.start()
    assert process.run() == 0
    supervisor.join()
    assert process.memory.note(Mailbox.RUN_END)


def test_it_requires_the_rate_of_a_real_board_and_reports_its_time(process):
    process.job = replace(process.job, board="usb2:")
    assert process.run() == 0
    assert process.rates == [process.job.config.period_ns]
    assert process.memory.note(Mailbox.HEADER)["pace"] == PACE


@pytest.mark.parametrize("wanted", [{"frames": True}, {"wire": "wire.json"}], ids=["frames", "wire"])
def test_wire_records_are_kept_when_the_board_is_released(process, tmp_path, wanted):
    wanted = {name: str(tmp_path / value) if name == "wire" else value for name, value in wanted.items()}
    process.job = replace(process.job, **wanted)
    assert process.run() == 0
    assert process.words[Field.SAVING] == 1
    assert (tmp_path / "wire.json").exists() == ("wire" in wanted)
    assert process.memory.frames.exists() == ("frames" in wanted)


def test_a_board_without_a_guardian_is_not_opened(process):
    process.words[Field.GUARDING_PID] = 0
    code = process.run()
    posted = process.memory.note(Mailbox.FAILURE)
    assert (code, posted["kind"]) == (1, "BoardError")
    assert "the guardian does not watch" in posted["text"]
    assert process.memory.image(Mailbox.SAFE_IMAGE) is None


def test_what_it_raises_gives_its_exit_code(process, monkeypatch):
    def ended(*_):
        raise UnsafeError("not safe")

    monkeypatch.setattr(rt, "open_board", ended)
    assert process.run() == UnsafeError.exit_code
    assert process.memory.note(Mailbox.FAILURE)["text"] == "not safe"
    assert process.words[Field.HOLDER_PID] == os.getpid()


def test_a_defect_is_reported_with_its_traceback_and_ends_the_process(process, monkeypatch, capfd):
    monkeypatch.setattr(rt, "build_pipeline", lambda *_: 1 // 0)
    assert process.run() == 1
    assert process.memory.note(Mailbox.FAILURE)["kind"] == "ZeroDivisionError"
    assert "Traceback" in capfd.readouterr().err
