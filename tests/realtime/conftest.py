"""Stacks for the loop: scripted parts, or the real board in front of the mock device. Shared memory, processes."""

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from inteco_abs.boards import InProcessLink, Link
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.errors import LinkError
from inteco_abs.mock_board import Device
from inteco_abs.realtime import Clock, Loop, StopFlag, TickRing, VirtualClock, clock
from inteco_abs.realtime import memory as shared
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import RunMemory
from inteco_abs.sessions import TICK, TRUTH, pack_tick
from inteco_abs.signals import BoardFlags, Command, Phase, Reason, Sample, Tick, Timing

PERIOD_NS = 500_000
QUICK = (
    "experiment.start_speed_rad_s=15.0",
    "experiment.idle_s=0.01",
    "experiment.hold_s=0.02",
    "experiment.drive_duty=0.8",
)


READ_NS = 50
"""What one look at the fake clock takes, so that spinning comes to an end."""


class FakeTime:
    """Stands in for the module `time`: a clock that advances when it is read, slept on or `spend`s."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000_007
        self.oversleep_ns = 0
        self.slept_ns: list[int] = []

    def monotonic_ns(self) -> int:
        self.now_ns += READ_NS
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.slept_ns.append(round(seconds * 1e9))
        self.now_ns += self.slept_ns[-1] + self.oversleep_ns

    def spend(self, duration_ns: int) -> None:
        self.now_ns += duration_ns


@pytest.fixture(scope="session")
def with_fake_time():
    """Calls a function with a fake time in the place of `time` in the clocks' module."""

    def call(work: Callable[[FakeTime], None]) -> None:
        with pytest.MonkeyPatch.context() as patch:
            fake = FakeTime()
            patch.setattr(clock, "time", fake)
            work(fake)

    return call


@pytest.fixture
def fake_time(monkeypatch):
    fake = FakeTime()
    monkeypatch.setattr(clock, "time", fake)
    return fake


def tick_of(sample: Sample, command: Command, stop_request: Reason, timing: Timing) -> Tick:
    inputs = (sample.time_ns, sample.tick, sample.dt_s, sample.wheel_count, sample.road_count, sample.board_flags)
    estimate = (0.0, 0.0, 0.0, True)
    demand = (Phase.SPIN_UP, math.nan, 0.0, 0.0, *command)
    return Tick(
        *inputs, stop_request, *estimate, *demand, *command, Reason.NONE, 0.0, 0.0, 0.0, 0.0, *map(float, timing[:3]),
        timing.skipped,
    )  # fmt: skip


class ScriptedBoard:
    """Notes the commands it is given; `during` happens inside each exchange."""

    def __init__(self, now_ns: Callable[[], int], during: Callable[[int], None] = lambda _tick: None) -> None:
        self.commands: list[Command] = []
        self._now_ns = now_ns
        self._during = during

    def exchange(self, command: Command) -> Sample:
        tick = len(self.commands)
        self.commands.append(command)
        self._during(tick)
        return Sample(tick, self._now_ns(), 0.0005, tick, tick, BoardFlags.NONE)


class ScriptedPipeline:
    """Decides by `script`, tick by tick, and has finished at its end; raises an exception in it."""

    def __init__(self, script: list[Command | BaseException], during: Callable[[int], None] = lambda _tick: None):
        self.seen: list[tuple[Sample, Reason, Timing]] = []
        self.command = Command.SAFE
        self._script = script
        self._during = during

    @property
    def finished(self) -> bool:
        return len(self.seen) >= len(self._script)

    def step(self, sample: Sample, stop_request: Reason, timing: Timing) -> Tick:
        decision = self._script[len(self.seen)]
        self._during(len(self.seen))
        self.seen.append((sample, stop_request, timing))
        if isinstance(decision, BaseException):
            raise decision
        self.command = decision
        return tick_of(sample, decision, stop_request, timing)


class ScriptedLoop:
    """A loop of scripted parts; `events` is what happened, in order."""

    def __init__(
        self,
        script: list[Command | BaseException],
        beats: Clock | None = None,
        *,
        io: Callable[[int], None] = lambda _tick: None,
        decide: Callable[[int], None] = lambda _tick: None,
        record: Callable[[int], None] = lambda _tick: None,
    ) -> None:
        def noted(name: str, during: Callable[[int], None]) -> Callable[[int], None]:
            def note(tick: int) -> None:
                self.events.append((name, tick))
                during(tick)

            return note

        def pack(_buffer: bytearray, _offset: int, tick: Tick) -> None:
            noted("record", record)(tick.tick)
            self.ticks.append(tick)

        self.events: list[tuple[str, int]] = []
        self.ticks: list[Tick] = []
        self.stop = StopFlag()
        beats = VirtualClock(PERIOD_NS) if beats is None else beats
        self.board = ScriptedBoard(beats.now_ns, noted("exchange", io))
        self.pipeline = ScriptedPipeline(script, noted("decide", decide))
        self.loop = Loop(self.board, self.pipeline, beats, TickRing(pack, 1, len(script) + 1), self.stop)


@pytest.fixture(scope="session")
def scripted_loop():
    return ScriptedLoop


class FlakyLink(Link):
    """Loses the answers whose numbers, counted from the first exchange, are in `lost`."""

    def __init__(self, inner: Link) -> None:
        self.lost: set[int] | range = set()
        self.failed = 0
        self.answers = 0
        self._inner = inner

    def write(self, data: bytes | bytearray) -> None:
        self._inner.write(data)

    def read(self, length: int) -> bytes:
        answer = self._inner.read(length)
        number, self.answers = self.answers, self.answers + 1
        if number in self.lost:
            self.failed += 1
            raise LinkError("no answer")
        return answer

    def close(self) -> None:
        self._inner.close()


class Stack:
    """The real board, link and ring in front of the mock device. `loop` is for use inside `with stack.board`."""

    def __init__(self, *settings: str, beats: Clock | None = None, capacity: int = 20_000) -> None:
        self.config = load_config(settings=[*QUICK, *settings])
        beats = VirtualClock(self.config.period_ns) if beats is None else beats
        self.device = Device(self.config, beats.now_ns, 1)
        self.link = FlakyLink(InProcessLink(Usb2FrontEnd(self.device)))
        self.board = RtdacUsb2(self.link, self.config.board, beats.now_ns, self.config.period_ns)
        self.ring = TickRing(pack_tick, TICK.size, capacity)
        self.stop = StopFlag()
        self._beats = beats

    def loop(self, pipeline=None, changes=None) -> Loop:
        self.link.answers = 0
        pipeline = build_pipeline(self.config) if pipeline is None else pipeline
        return Loop(self.board, pipeline, self._beats, self.ring, self.stop, changes)

    def rows(self):
        """Records that were not taken yet, as a structured array."""
        return TICK.array(self.ring.reader().take())


@pytest.fixture(scope="session")
def new_stack():
    return Stack


@pytest.fixture(scope="session")
def scripted_pipeline():
    return ScriptedPipeline


@pytest.fixture
def memory_folder(monkeypatch):
    """Where memories are made meanwhile: a folder of its own, with a name short enough for a socket in it."""
    # with the number of this process, so that tools/mutate can take away what a killed one leaves
    with tempfile.TemporaryDirectory(prefix=f"abs-{os.getpid()}-", dir=shared.FOLDER) as folder:
        monkeypatch.setattr(shared, "FOLDER", Path(folder))
        yield Path(folder)


@pytest.fixture
def new_memory(memory_folder):
    """Makes the memory of a run."""

    def make(ticks: int = 50, truths: int = 50) -> RunMemory:
        memory = RunMemory.create(TICK.size, ticks, TRUTH.size, truths)
        assert memory.path.parent == memory_folder
        return memory

    return make


@pytest.fixture
def memory(new_memory):
    return new_memory()


@pytest.fixture
def job_of(tmp_path):
    """The job of the run in a memory, posted there."""

    def post(memory: RunMemory, *settings: str, out: str = "stop.mcap") -> Job:
        config = load_config(settings=[*QUICK, *settings])
        path = str(tmp_path / out)
        job = Job(path, path, "sim:", f"sim:{memory.socket}", 1, "an-id", config, b"", {"software": {"seed": "1"}})
        job.post(memory)
        return job

    return post


@pytest.fixture
def child():
    """Starts processes that are gone when the test is over; by default one that sleeps."""
    started: list[subprocess.Popen] = []

    def start(*command: object, **options) -> subprocess.Popen:
        started.append(subprocess.Popen([*map(str, command)] or ["sleep", "600"], **options))
        return started[-1]

    yield start
    for process in started:
        with process:  # which waits, and closes its pipes
            process.kill()


@pytest.fixture
def python_child(child):
    """Starts a Python process that runs `code`, with its standard output as text."""

    def start(code: str, *arguments: object, **options) -> subprocess.Popen:
        return child(sys.executable, "-c", code, *arguments, stdout=subprocess.PIPE, text=True, **options)

    return start


@pytest.fixture
def ended(child):
    """Pid of a process that has ended and was asked how."""
    process = child()
    process.kill()
    process.wait()
    return process.pid
