"""Recorded stops, their bytes record by record, and the means to change them."""

import resource
import shutil
import signal
import struct
import zlib
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tracing import untraced

import inteco_abs.experiment.run
import inteco_abs.experiment.virtual_run
from inteco_abs.analysis import replay_session
from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import CONTROLLERS, build_pipeline, control_check
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.mock_board import Device
from inteco_abs.sessions import TICK, FileWriter, RunResult, Session, read_session, result_card, session_config
from inteco_abs.signals import Phase

QUICK = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")
TINY = ("experiment.start_speed_rad_s=10.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0", "loop.rate_hz=200.0")
CHUNKED = ("experiment.start_speed_rad_s=60.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")

MAGIC = b"\x89MCAP0\r\n"
CHUNK, DATA_END, FOOTER = 6, 15, 2
HEAD = struct.Struct("<BQ")


class Run(NamedTuple):
    path: Path
    stop: RunResult
    config: RigConfig

    @property
    def session(self) -> Session:
        return read_session(self.path)


def _run(path, settings, *, seed=1, controllers=CONTROLLERS, progress=None, traced=False, **plan) -> Run:
    config = load_config(settings=settings, checks=[control_check(controllers)])
    what = Plan(out=path, seed=seed, controllers=controllers, **plan)
    run = partial(untraced, run_stop) if what.virtual and not traced else run_stop
    return Run(path, run(config, what, progress), config)


@pytest.fixture(scope="session")
def run_at():
    """Runs one stop in virtual time, at a given path."""
    return _run


@pytest.fixture
def run(tmp_path):
    """Runs one quick stop in virtual time; more settings may follow."""

    def make(*settings, name="stop.mcap", **options) -> Run:
        return _run(tmp_path / name, (*QUICK, *settings), **options)

    return make


@pytest.fixture(scope="session")
def quick(tmp_path_factory):
    """A completed stop from 20 rad/s."""
    return _run(tmp_path_factory.mktemp("quick") / "stop.mcap", QUICK)


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """A completed stop of a few hundred ticks, for tests that read many variants of it."""
    return _run(tmp_path_factory.mktemp("tiny") / "stop.mcap", TINY)


@pytest.fixture(scope="session")
def chunked(tmp_path_factory):
    """A completed stop whose ticks fill more than one chunk."""
    return _run(tmp_path_factory.mktemp("chunked") / "stop.mcap", CHUNKED)


def record_again(run: Run, path: Path, ticks: int, flushed_after: int) -> Path:
    """The first ticks of a run as a session of its own, in chunks of so many ticks."""
    session = run.session
    card = result_card(run.config, session.ticks[:ticks], session.truth[:ticks])
    with FileWriter(path, int(session.ticks["time_ns"][0]), epoch_ns=session.epoch_ns) as recorder:
        for name, facts in session.metadata.items():
            if name not in {"session", "result", "integrity"}:
                recorder.describe(name, facts)
        for name, data in session.attachments.items():
            recorder.attach(name, "application/toml", data)
        recorder.begin({})
        for first in range(0, ticks, flushed_after):
            end = min(first + flushed_after, ticks)
            recorder.ticks(session.ticks[first:end].tobytes())
            recorder.truths(session.truth[first:end].tobytes())
            recorder.flush()
        recorder.finish("completed", "no fault", {**card, "lost_ticks": 0})
    return path


@pytest.fixture(scope="session")
def short(tmp_path_factory, tiny):
    """A session of 60 ticks in six chunks, for tests that break it in a thousand ways."""
    return record_again(tiny, tmp_path_factory.mktemp("short") / "short.mcap", 60, 10)


@pytest.fixture(scope="session")
def cut_short(short):
    """Bytes of the short session up to the middle of a chunk, behind 30 ticks."""
    chunks = [record for record in Container.split(short.read_bytes()) if record.opcode == CHUNK]
    return short.read_bytes()[: (chunks[4].at + chunks[4].end) // 2]


@pytest.fixture(scope="session")
def with_a_flipped_bit():
    """Bytes of a file of which one bit, amid the packed records of its last chunk, is another."""

    def flip(data: bytes) -> bytes:
        chunk = [record for record in Container.split(data) if record.opcode == CHUNK][-1]
        changed = bytearray(data)
        changed[(chunk.at + chunk.end) // 2] ^= 1
        return bytes(changed)

    return flip


@pytest.fixture(scope="session")
def before_its_ticks():
    """Bytes of a file up to the middle of its first chunk's head, which is behind what says with what it was run."""

    def cut(data: bytes) -> bytes:
        return data[: next(record.at for record in Container.split(data) if record.opcode == CHUNK) + 4]

    return cut


class Official(NamedTuple):
    """What the official reader finds, every checksum validated; messages as (schema, channel, message, decoded)."""

    header: object
    summary: object
    messages: list
    metadata: list
    attachments: list

    def of(self, topic: str) -> list:
        return [entry for entry in self.messages if entry[1].topic == topic]


@pytest.fixture(scope="session")
def officially():
    """Reads a file with the official MCAP and protobuf libraries."""

    def read(path) -> Official:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            return Official(
                reader.get_header(),
                reader.get_summary(),
                list(reader.iter_decoded_messages(log_time_order=False)),
                list(reader.iter_metadata()),
                list(reader.iter_attachments()),
            )

    return read


@pytest.fixture(scope="session")
def message_class():
    """Class that the official protobuf library makes of a message in a serialised FileDescriptorSet."""

    def make(descriptor: bytes, name: str):
        pool = DescriptorPool()
        for file in FileDescriptorSet.FromString(descriptor).file:
            pool.Add(file)
        return GetMessageClass(pool.FindMessageTypeByName(name))

    return make


class Record(NamedTuple):
    """One record, of a file or of a chunk; `at` is where its opcode stands."""

    opcode: int
    content: bytes
    at: int = -1

    @property
    def end(self) -> int:
        return self.at + HEAD.size + len(self.content)

    def __bytes__(self) -> bytes:
        return HEAD.pack(self.opcode, len(self.content)) + self.content


class Container:
    """The container format by hand: split, join with a right data checksum, craft."""

    record = Record
    magic = MAGIC

    @staticmethod
    def split(data: bytes, at: int = len(MAGIC)) -> list[Record]:
        end = len(data) - len(MAGIC) if data.startswith(MAGIC) and at else len(data)
        records = []
        while at < end:
            opcode, length = HEAD.unpack_from(data, at)
            records.append(Record(opcode, data[at + HEAD.size : at + HEAD.size + length], at))
            at = records[-1].end
        return records

    @staticmethod
    def join(records: Iterable[Record]) -> bytes:
        data = bytearray(MAGIC)
        for record in records:
            fresh = record.opcode == DATA_END
            data += bytes(Record(DATA_END, struct.pack("<I", zlib.crc32(data))) if fresh else record)
        return bytes(data) + MAGIC

    @classmethod
    def craft(cls, *records: Record) -> bytes:
        header = Record(1, cls.text("") + cls.text("by hand"))
        return cls.join([header, *records, Record(DATA_END, b""), Record(FOOTER, bytes(20))])

    @staticmethod
    def text(text: str) -> bytes:
        return struct.pack("<I", len(text.encode())) + text.encode()

    @classmethod
    def chunk(cls, packed: bytes, size: int, compression: str, crc: int = 0) -> Record:
        head = struct.pack("<QQQI", 0, 0, size, crc) + cls.text(compression)
        return Record(6, head + struct.pack("<Q", len(packed)) + packed)

    @staticmethod
    def unpack(chunk: Record) -> bytes:
        (size,) = struct.unpack_from("<Q", chunk.content, 16)
        (name,) = struct.unpack_from("<I", chunk.content, 28)
        return zstandard.decompress(chunk.content[40 + name :], size)


@pytest.fixture(scope="session")
def container():
    return Container


@pytest.fixture
def altered(tmp_path):
    """Path of a file with the given bytes."""

    def write(data: bytes, name: str = "altered.mcap") -> Path:
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


@pytest.fixture(scope="session")
def replayed():
    """Replays a session with the configuration inside it."""

    def again(session, controllers=CONTROLLERS, tolerances=None):
        config = session_config(session, (control_check(controllers),))
        return untraced(replay_session, session, build_pipeline(config, controllers), tolerances)

    return again


@pytest.fixture
def devices(monkeypatch):
    """Every mock device that a run makes, in order."""
    made = []

    class Remembered(Device):
        def __init__(self, *args, **kwargs) -> None:
            super().__init__(*args, **kwargs)
            made.append(self)

    monkeypatch.setattr(inteco_abs.experiment.virtual_run, "Device", Remembered)
    return made


@pytest.fixture
def at_phase(monkeypatch):
    """Has something called during the first tick of a phase."""

    def arrange(phase: Phase, action) -> None:
        def build(*args, **kwargs):
            pipeline = build_pipeline(*args, **kwargs)
            step, pending = pipeline.step, [action]

            def watched(*inputs):
                tick = step(*inputs)
                if tick.phase is phase and pending:
                    pending.pop()()
                return tick

            pipeline.step = watched
            return pipeline

        monkeypatch.setattr(inteco_abs.experiment.run, "build_pipeline", build)

    return arrange


@pytest.fixture
def vanishing(at_phase, tmp_path):
    """A folder for sessions that is removed in mid-run; a path in it."""
    (tmp_path / "out").mkdir()
    at_phase(Phase.BRAKING, lambda: shutil.rmtree(tmp_path / "out"))
    return "out/stop.mcap"


@pytest.fixture
def outer_signals():
    """Numbers of signals that reached the handlers outside of a run; handlers must be the same afterwards."""
    received = []

    def outer(number, _frame) -> None:
        received.append(number)

    wanted = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, outer) for number in wanted}
    yield received
    found = {number: signal.signal(number, handler) for number, handler in before.items()}
    assert found == dict.fromkeys(wanted, outer)


@pytest.fixture
def room():
    """No file may grow beyond that many bytes for the rest of the test; stands for a full disk."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    return lambda left: resource.setrlimit(resource.RLIMIT_FSIZE, (left, hard))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call():
    """Lift what `room` has limited before pytest reports how the test ended: its own output may be a larger file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        return (yield)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="session")
def retouched():
    """A session with values of one tick replaced."""

    def change(session: Session, row: int, **values) -> Session:
        payload = bytearray(session.payload)
        writable = np.frombuffer(payload, TICK.dtype)
        for name, value in values.items():
            writable[name][row] = value
        return session.with_rows(TICK.array(bytes(payload)))

    return change
