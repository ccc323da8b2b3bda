"""No bit of what a replay rests on can change unnoticed: not of a tick, not of a gain, not of the configuration."""

import struct
import zlib
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from inteco_abs.analysis import changed_gains, replay_session
from inteco_abs.control import CONTROLLERS, REFERENCE, build_pipeline, control_check, gains_in_force
from inteco_abs.errors import SessionError
from inteco_abs.format.protobuf import chunk, double, tag
from inteco_abs.format.schema import Role
from inteco_abs.sessions import CONFIG_NAME, TICK, FileWriter, read_session, session_config, validate
from inteco_abs.signals import Phase

pytestmark = pytest.mark.untraced

CHUNK, ATTACHMENT, METADATA = 6, 9, 12
SHOWS_IN = {
    "time_ns": {"time_ns"},
    "tick": {"tick"},
    "dt_s": {"dt_s"},
    "wheel_count": {"wheel_speed_rad_s"},
    "road_count": {"road_speed_rad_s"},
    "board_flags": {"wheel_speed_rad_s", "road_speed_rad_s", "estimate_valid"},
    "stop_request": {"phase"},
}
"""By input, the first field that is not what the log says."""
STEPS = [7, pytest.param(1, marks=pytest.mark.long)]
"""Every seventh bit meets all places in a byte."""
LATEST = 2
"""Ticks after which a change shows: a flagged sample may have the value that is held in its place."""


def bits_of(name):
    """Places of every bit of a column in a record."""
    layout, start = TICK.dtype.fields[name]
    return range(8 * start, 8 * (start + layout.itemsize))


def flipped(data, bit):
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.fixture(scope="module")
def stop(tmp_path_factory, run_at):
    """A stop of few ticks with gains of its own."""
    path = tmp_path_factory.mktemp("bits") / "stop.mcap"
    settings = ("experiment.start_speed_rad_s=10.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0",
                "loop.rate_hz=200.0", "controller.gains.Mk=2.25", "controller.gains.Mq=1e-05")  # fmt: skip
    return run_at(path, settings).session


@pytest.fixture(scope="module")
def config(stop):
    return session_config(stop, (control_check(CONTROLLERS),))


@pytest.fixture(scope="module")
def in_force(config):
    return {REFERENCE: config.controller.reference_slip, **gains_in_force(config)}


class Flips:
    """Replays of a session's first ticks with one bit of its newest but a few changed, checksums and hash right."""

    def __init__(self, session, config, row) -> None:
        self.config, self.row = config, row
        payload = session.payload[: (row + LATEST + 1) * TICK.size]
        self.session = session.with_rows(TICK.array(payload))

    def replayed(self, bit):
        """The replay; what is said instead if there is none."""
        payload = flipped(self.session.payload, 8 * TICK.size * self.row + bit)
        if not TICK.well_formed(payload):
            return "no tick"
        session = self.session.with_rows(TICK.array(payload))
        try:
            return replay_session(session, build_pipeline(self.config))
        except SessionError as refusal:
            return str(refusal)


@pytest.fixture(scope="module", params=[Phase.SPIN_UP, Phase.BRAKING], ids=lambda phase: phase.name)
def flips(request, stop, config):
    rows = np.flatnonzero(stop.ticks["phase"] == request.param)
    trial = Flips(stop, config, int(rows[10]))
    assert replay_session(trial.session, build_pipeline(config)).differing == 0
    return trial


def columns(role):
    return [column.name for column in TICK.columns if column.role is role]


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", columns(Role.INPUT))
def test_a_flip_of_any_bit_of_an_input_shows_in_the_replay_and_is_named(flips, name, step):
    for bit in bits_of(name)[::step]:
        found = flips.replayed(bit)
        if isinstance(found, str):  # a reason that there is not, a tick of a million years
            assert name == "stop_request" or f"tick {flips.row}: dt_s is" in found
            continue
        assert found.first.field in SHOWS_IN[name], bit
        assert flips.row <= found.first.tick <= flips.row + LATEST or name == "tick", bit


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", columns(Role.OUTPUT))
def test_a_flip_of_any_bit_of_an_output_is_named(flips, name, step):
    for bit in bits_of(name)[::step]:
        found = flips.replayed(bit)
        assert found == "no tick" or (found.first.tick, found.by_field) == (flips.row, {name: 1}), bit


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", columns(Role.TIMING))
def test_what_no_replay_can_know_is_left_to_the_hash(flips, name, step):
    assert not any(flips.replayed(bit).differing for bit in bits_of(name)[::step])


@pytest.fixture(scope="module")
def few(tmp_path_factory, stop, in_force):
    """Bytes of a session of three ticks, with its gains in all places."""
    path = tmp_path_factory.mktemp("few") / "few.mcap"
    with FileWriter(path, 0) as recorder:
        for name, facts in stop.metadata.items():
            recorder.describe(name, facts)
        recorder.attach(CONFIG_NAME, "application/toml", stop.attachments[CONFIG_NAME])
        recorder.begin(in_force)
        recorder.ticks(stop.payload[: 3 * TICK.size])
        recorder.finish("completed", "", {"overruns": 0, "lost_ticks": 0, "lateness_us": {}})
    return path.read_bytes()


@pytest.fixture
def variants(few, container, altered):
    """Files with one bit of one piece of a record flipped, every checksum right; with the bit's number in the piece."""

    def make(opcode, piece, bits):
        records = container.split(few)
        (at,) = (at for at, r in enumerate(records) if r.opcode == opcode and piece in content(container, r))
        record = records[at]
        start = 8 * content(container, record).index(piece)
        for bit in bits:
            changed = flipped(content(container, record), start + bit)
            if opcode == CHUNK:
                records[at] = container.chunk(changed, len(changed), "", zlib.crc32(changed))
            elif opcode == ATTACHMENT:
                records[at] = container.record(opcode, changed[:-4] + struct.pack("<I", zlib.crc32(changed[:-4])))
            else:
                records[at] = container.record(opcode, changed)
            yield bit, altered(container.join(records))

    return make


def content(container, record):
    return container.unpack(record) if record.opcode == CHUNK else record.content


def test_a_flip_in_any_byte_of_a_tick_is_found_by_the_hash(variants, stop):
    record = stop.payload[TICK.size : 2 * TICK.size]
    said = set()
    for bit, path in variants(CHUNK, record, range(0, 8 * len(record), 5)):
        with pytest.raises(SessionError, match=r"do not match the hash|does not match the") as refusal:
            read_session(path)
        said.add(str(refusal.value))
        if not bit % 8:
            assert validate(path).verdict == "wrong"
    assert len(said) == 2


def reported_gains(path, in_force):
    """Gains that a replay names; None if the file is refused."""
    try:
        return changed_gains(read_session(path), in_force)
    except SessionError:
        return None


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", ["Mk", "Mq", "lag_s", REFERENCE])
def test_a_flip_of_any_bit_of_a_gain_in_the_metadata_is_named(variants, container, in_force, name, step):
    value = in_force[name]
    entries = {name: repr(value)} if name == REFERENCE else {f"gain.{name}": repr(value),
                                                           f"gain.{name}.hex": value.hex()}  # fmt: skip
    for key, text in entries.items():
        pair = container.text(key) + container.text(text)
        letters = [*range(4, 4 + len(key)), *range(8 + len(key), len(pair))]
        bits = [8 * at + bit for at, bit in product(letters, range(8))]
        for _, path in variants(METADATA, pair, bits[::step]):
            reported = reported_gains(path, in_force)
            assert reported is None or name in reported


@pytest.mark.parametrize("step", STEPS)
def test_a_flip_of_any_bit_of_the_parameters_is_named(variants, in_force, step):
    entries = [chunk(1, chunk(1, name) + double(2, value)) for name, value in in_force.items()]
    message = b"".join(entries) + tag(2, 5) + bytes(4)
    for bit, path in variants(CHUNK, message, range(0, 8 * len(message), step)):
        assert reported_gains(path, in_force) != {}, bit


@pytest.mark.parametrize("step", STEPS)
def test_a_flip_of_any_bit_of_the_controllers_configuration_is_named(stop, config, step):
    """Right checksum, right hash: only what it says is wrong."""
    text = stop.attachments[CONFIG_NAME]
    section = text[text.index(b"[controller]") :]
    end = section.index(b"\n[", section.index(b"[controller.gains]") + 1)
    start = 8 * text.index(b"[controller]")
    refusals, the_same = set(), 0
    for bit in range(start, start + 8 * end, step):
        session = replace(stop, attachments={CONFIG_NAME: flipped(text, bit)})
        try:
            other = session_config(session, (control_check(CONTROLLERS),))
        except SessionError as refusal:
            refusals.add(CONFIG_NAME in str(refusal))
            continue
        now = {REFERENCE: other.controller.reference_slip, **gains_in_force(other)}
        if not changed_gains(session, now) and not replay_session(session, build_pipeline(other)).differing:
            assert other == config or other.controller.hold_below_rad_s != config.controller.hold_below_rad_s, bit
            the_same += 1
    assert refusals == {True}
    assert the_same < 60 / step


def test_a_flip_anywhere_in_the_configuration_is_found_by_its_hash(variants, stop):
    """Also of what decides nothing."""
    text = stop.attachments[CONFIG_NAME]
    for _, path in variants(ATTACHMENT, text, range(0, 8 * len(text), 23)):
        with pytest.raises(SessionError, match=r"'config\.toml' does not match the hash"):
            read_session(path)
