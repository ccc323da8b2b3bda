"""Long sessions are read in parts: by their index, in blocks, and a second out of the middle."""

import itertools
import os
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.analysis import alternative, continued, diff_sessions, parse_tolerances, replay_session
from inteco_abs.control import CONTROLLERS, build_pipeline, control_check
from inteco_abs.errors import SessionError
from inteco_abs.sessions import TICK, open_session, read_session, rows, session_config
from inteco_abs.views import figure

FOOTER, CHUNK_INDEX, STATISTICS, DATA_END = 2, 8, 11, 15


@pytest.fixture
def long_session(chunked, monkeypatch):
    """The chunked session as a long one: its rows stay in the file."""
    monkeypatch.setattr(rows, "MOST_IN_MEMORY", 1000)
    return read_session(chunked.path)


@pytest.fixture(params=["long", "by index"])
def stored(request, long_session, chunked):
    return long_session if request.param == "long" else open_session(chunked.path)


def test_a_long_session_has_the_rows_of_a_short_one(stored, chunked):
    whole = chunked.session
    assert stored.ticks.tobytes() == whole.ticks.tobytes()
    assert stored.truth.tobytes() == whole.truth.tobytes()
    assert stored.payload == whole.payload
    assert (stored.tick_count, stored.truth_count) == (len(whole.ticks), len(whole.truth))
    assert stored.rows.phases == whole.rows.phases
    assert stored.duration_s == whole.duration_s > 0.0


def test_the_index_tells_what_the_whole_file_does(chunked):
    whole, indexed = chunked.session, open_session(chunked.path)
    for name in ("metadata", "attachments", "channels", "epoch_ns", "incomplete", "unsupported", "frames", "events"):
        assert getattr(indexed, name) == getattr(whole, name), name
    assert (list(indexed.log), list(indexed.parameters)) == (list(whole.log), list(whole.parameters))


@pytest.mark.parametrize("ticks", [1, 700, 1 << 16])
def test_blocks_are_all_rows_in_step(stored, chunked, ticks):
    whole, blocks = chunked.session, list(stored.blocks(ticks))
    assert b"".join(part.tobytes() for part, _ in blocks) == whole.ticks.tobytes()
    assert b"".join(part.tobytes() for _, part in blocks) == whole.truth.tobytes()
    assert all(len(part) == ticks for part, _ in blocks[:-1])
    for (one, _), (_, later) in itertools.pairwise(blocks):
        assert not len(later) or later["time_ns"][0] > one["time_ns"][-1]


@pytest.mark.parametrize(("first_s", "end_s"), [(None, None), (0.2, 0.5), (0.0, 0.0), (0.1, None), (5000.0, 6000.0)])
def test_a_part_has_the_ticks_of_its_time(stored, chunked, first_s, end_s):
    part, whole = stored[first_s:end_s], chunked.session
    since_s = (whole.ticks["time_ns"] - whole.ticks["time_ns"][0]) * 1e-9
    inside = (since_s >= (first_s or 0.0)) & (since_s < (np.inf if end_s is None else end_s))
    first = int(inside.argmax()) * TICK.size
    assert part.payload == whole.payload[first : first + int(inside.sum()) * TICK.size]
    assert part.metadata == whole.metadata


def test_a_part_reads_the_chunks_of_its_time_alone(chunked, monkeypatch):
    read, unpack = [], rows.unpack_chunk
    monkeypatch.setattr(rows, "unpack_chunk", lambda data, budget: read.append(len(data)) or unpack(data, budget))
    session = open_session(chunked.path)
    opened = len(read)
    assert len(session[0.0:0.001].ticks)
    assert opened == 1
    assert len(read) <= opened + 3  # the edges, and one chunk


@pytest.mark.parametrize("part", [slice(1.0, 0.5), slice(-1.0, 2.0), slice(0.0, 1.0, 2)])
def test_what_is_no_part_is_refused(chunked, part):
    with pytest.raises(ValueError, match="must"):
        chunked.session[part]


def test_a_part_is_not_replayed(chunked):
    with pytest.raises(SessionError, match="replay the whole session"):
        replay_session(chunked.session[0.1:0.2], build_pipeline(session_config(chunked.session, (control_check(),))))


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_long_session_replays_block_by_block(long_session, monkeypatch, compiled):
    monkeypatch.setattr(type(long_session), "blocks", lambda session, *_: rows.in_step(session.rows.parts(), 1000))
    found = replay_session(
        long_session, build_pipeline(session_config(long_session, (control_check(),))), compiled=compiled
    )
    assert (found.ticks, found.differing) == (long_session.tick_count, 0)


@pytest.mark.parametrize("tolerances", [(), ("*=1e-3:1e-3", "phase=::0.01:0.02", "slip=0.1::0.003")])
def test_a_long_session_that_differs_is_compared_as_a_short_one(chunked, monkeypatch, tolerances):
    draw, changed = np.random.default_rng(3), chunked.session.ticks.copy()
    for name in ("slip", "torque_demand_nm", "phase", "estimate_valid", "dt_s", "tick"):
        at = draw.integers(len(changed), size=4)
        changed[name][at] = changed[name][at[::-1]]
    changed["time_ns"][draw.integers(len(changed), size=4)] += 40_000
    changed["slip"][900:1100] += 1e-4
    changed["phase"] = np.roll(changed["phase"], 7)
    other = chunked.session.with_rows(changed)
    found = []
    for ticks in (1 << 20, 1000, 37):
        monkeypatch.setattr("inteco_abs.analysis.replay._COMPARED_TICKS", ticks)
        pipeline = build_pipeline(session_config(chunked.session, (control_check(),)))
        found.append(replay_session(other, pipeline, parse_tolerances(tolerances), compiled=False))
    assert found[0].differing > 0
    assert len(found[0].shifts) > 1
    assert found[1:] == found[:1] * 2


def test_a_long_session_continues_in_simulation_as_a_short_one(long_session, chunked, monkeypatch):
    own, found = session_config(chunked.session, ()), []
    other = alternative(chunked.session, ("controller.gains.Mk=5",), CONTROLLERS)
    for session, ticks, keep in ((chunked.session, 1 << 20, True), (long_session, 700, False)):
        monkeypatch.setattr(type(session), "blocks", lambda session, *_, n=ticks: rows.in_step(session.rows.parts(), n))
        monkeypatch.setattr("inteco_abs.analysis.closed_loop.BLOCK_TICKS", ticks)
        found.append(continued(session, own, other, CONTROLLERS, 0.05, keep=keep))
    whole, parts = found
    assert (parts.ticks, parts.truth) == (None, None)
    assert parts == replace(whole, ticks=None, truth=None, distance=parts.distance)
    assert parts.distance == pytest.approx(whole.distance)
    assert whole.distance["slip"] > 0.0


def test_signals_of_long_sessions_differ_as_those_of_short_ones(long_session, chunked, monkeypatch):
    other = chunked.session.ticks.copy()
    other["slip"][-700] += 0.25
    other["torque_demand_nm"][-900:-800] = np.nan
    changed = chunked.session.with_rows(other)
    (slip, torque) = diff_sessions(chunked.session, changed, ("signals",)).changes["signals"]
    monkeypatch.setattr(type(long_session), "blocks", lambda session, *_: rows.in_step(session.rows.parts(), 333))
    in_blocks = diff_sessions(long_session, changed, ("signals",)).changes["signals"]
    assert in_blocks == [slip._replace(rms_difference=pytest.approx(slip.rms_difference)), torque]


def test_a_long_session_is_drawn_as_a_short_one(long_session, chunked, monkeypatch):
    monkeypatch.setattr(figure, "_DRAWN_POINTS", 500)

    def lines(session):
        return [line.get_xydata().tobytes() for axes in figure.figure_of([session]).axes for line in axes.get_lines()]

    expected = lines(chunked.session)
    monkeypatch.setattr(type(long_session), "blocks", lambda session, *_: rows.in_step(session.rows.parts(), 77))
    assert lines(long_session) == expected


def test_a_file_that_changed_is_not_read_on(chunked, tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "MOST_IN_MEMORY", 1000)
    path = tmp_path / "stop.mcap"
    path.write_bytes(chunked.path.read_bytes())
    session = open_session(path)
    os.utime(path, (1, 1))
    with pytest.raises(SessionError, match="has changed since it was opened"):
        session.ticks  # noqa: B018  reads the file


def test_damage_is_found_where_it_is_read(chunked, tmp_path, with_a_flipped_bit):
    path = tmp_path / "stop.mcap"
    path.write_bytes(with_a_flipped_bit(chunked.path.read_bytes()))
    session = open_session(path)
    assert session.metadata == chunked.session.metadata
    with pytest.raises(SessionError, match=r"is damaged: .*recover"):
        session.ticks  # noqa: B018  reads the file


def test_without_an_index_all_is_read(cut_short, altered):
    session = open_session(altered(cut_short))
    assert session.incomplete
    assert session.tick_count == 30


def without_statistics(opcode, data):
    return b"" if opcode == STATISTICS else data


def of_an_unknown_channel(opcode, data):
    return data[:-10] + struct.pack("<H", 999) + data[-8:] if opcode == STATISTICS else data


def without_channels(opcode, data):
    (size,) = struct.unpack_from("<I", data, 41) if opcode == CHUNK_INDEX else (0,)
    if opcode != CHUNK_INDEX:
        return data
    return data[:1] + struct.pack("<Q", len(data) - 9 - size) + data[9:41] + bytes(4) + data[45 + size :]


def of_too_many(opcode, data):
    if opcode != STATISTICS:
        return data
    counts = [struct.pack("<HQ", channel, 10**9) for channel, _ in struct.iter_unpack("<HQ", data[55:])]
    return data[:55] + b"".join(counts)


@pytest.mark.parametrize("change", [without_statistics, of_an_unknown_channel, without_channels, of_too_many])
def test_an_index_that_contradicts_itself_is_not_trusted(tiny, container, altered, change):
    records = container.split(tiny.path.read_bytes())
    ended = [record.opcode for record in records].index(DATA_END) + 1
    data = container.magic + b"".join(map(bytes, records[:ended]))
    summary = b"".join(change(record.opcode, bytes(record)) for record in records[ended:-1])
    footer = struct.pack("<BQQQ", FOOTER, 20, len(data), 0)
    crc = struct.pack("<I", zlib.crc32(footer, zlib.crc32(summary)))
    session = open_session(altered(data + summary + footer + crc + container.magic))
    if change is of_too_many:
        with pytest.raises(SessionError, match="its index counts"):
            list(session.blocks())
    else:
        assert session.payload == tiny.session.payload
