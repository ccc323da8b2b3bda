"""What a recovery keeps of a session, and what it says of the rest."""

import json
import os
import struct
import tracemalloc
import zlib

import pytest

from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.quantities import Quantity
from inteco_abs.sessions import (
    TICK,
    FileWriter,
    content,
    gains_of,
    internals_of,
    read_session,
    recover_session,
    recovery,
    validate,
)
from inteco_abs.sessions.file_writer import utc
from inteco_abs.sessions.migration import message_layout

CHANNEL, CHUNK, ATTACHMENT, METADATA, DATA_END = 4, 6, 9, 12, 15
EVENTS = 2
"""Number of the log's channel."""


@pytest.fixture
def rescue(altered, tmp_path):
    """Recovers from the given bytes: what it says, and the session that it wrote."""

    def run(data):
        recovery = recover_session(altered(data), tmp_path / "out.mcap")
        return recovery, read_session(tmp_path / "out.mcap")

    return run


@pytest.fixture
def pieces(short, container):
    """Records of the short session, and which of them are its chunks; the first has the declarations."""
    records = container.split(short.read_bytes())
    return records, [at for at, record in enumerate(records) if record.opcode == CHUNK]


def joined(container, records):
    return container.magic + b"".join(map(bytes, records)) + container.magic


def spoilt(record):
    content = bytearray(record.content)
    content[60] ^= 0xFF
    return record._replace(content=bytes(content))


def test_damage_in_the_middle_costs_its_own_chunk_only(rescue, container, pieces):
    records, chunks = pieces
    records[chunks[3]] = spoilt(records[chunks[3]])
    recovery, session = rescue(joined(container, records))
    assert session.ticks["tick"].tolist() == [*range(20), *range(30, 60)]
    assert recovery.missing == ((20, 29),)
    assert any("chunk: fails its checksum" in loss for loss in recovery.losses)
    assert "ticks 20..29 are missing" in recovery.losses
    assert not any("hash" in loss for loss in recovery.losses)
    assert recovery.card["lost_ticks"] == 10


def test_what_looks_like_records_that_leave_the_file_does_not_end_the_search(rescue, container, pieces):
    records, chunks = pieces
    damaged = spoilt(records[chunks[3]])
    head = bytes([CHUNK]) + (60 << 20).to_bytes(8, "little")
    records[chunks[3]] = damaged._replace(
        content=damaged.content[:40] + 4 * head + damaged.content[40 + 4 * len(head) :]
    )
    _, session = rescue(joined(container, records))
    assert session.ticks["tick"].tolist() == [*range(20), *range(30, 60)]


def test_first_ticks_that_are_missing_are_counted_from_0(rescue, container, pieces):
    records, chunks = pieces
    records[chunks[1]] = spoilt(records[chunks[1]])
    assert rescue(joined(container, records))[0].missing == ((0, 9),)


def test_a_length_that_leads_elsewhere_is_not_followed(rescue, container, pieces):
    records, chunks = pieces
    data = bytearray(joined(container, records))
    struct.pack_into("<Q", data, records[chunks[2]].at + 1, records[chunks[5]].end - records[chunks[2]].at - 9)
    assert rescue(bytes(data))[1].ticks["tick"].tolist() == [*range(10), *range(20, 60)]


def test_ticks_survive_the_loss_of_their_declaration(rescue, container, pieces):
    records, chunks = pieces
    records[chunks[0]] = spoilt(records[chunks[0]])
    recovery, session = rescue(joined(container, records))
    assert len(session.ticks) == 60
    assert len(session.truth) == 60
    assert recovery.losses


def test_a_chunk_without_a_checksum_gives_no_tick(rescue, container, pieces):
    records, chunks = pieces
    raw = container.unpack(records[chunks[4]])
    records[chunks[4]] = container.chunk(raw, len(raw), "", 0)
    assert rescue(joined(container, records))[0].missing == ((30, 39),)


def test_a_chunk_that_comes_twice_is_taken_once(rescue, container, pieces):
    records, chunks = pieces
    records.insert(chunks[5], records[chunks[3]])
    recovery, session = rescue(joined(container, records))
    assert session.ticks["tick"].tolist() == list(range(60))
    assert any("repeats earlier" in loss for loss in recovery.losses)


def test_a_chunk_of_another_session_gives_no_tick(rescue, container, pieces, tiny):
    records, chunks = pieces
    stranger = next(r for r in container.split(tiny.path.read_bytes())[::-1] if r.opcode == CHUNK)
    raw = container.unpack(stranger)
    shifted = b"".join(
        bytes(e if e.opcode != 5 else container.record(5, e.content[:6] + bytes(8) + e.content[14:]))
        for e in container.split(raw, 0)
    )
    records.insert(chunks[5] + 1, container.chunk(shifted, len(shifted), "", zlib.crc32(shifted)))
    recovery, session = rescue(joined(container, records))
    assert len(session.ticks) == 60
    assert any("two clocks do not match" in loss for loss in recovery.losses)


MESSAGE_HEAD = struct.Struct("<HIQQ")


def altered_chunk(container, record, change):
    """The chunk after `change` of each tick's values, with its times and its checksum right."""
    parts = container.split(container.unpack(record), 0)
    for at, part in enumerate(parts):
        if part.opcode == 5 and len(part.content) == MESSAGE_HEAD.size + TICK.size:
            channel, sequence, log_time, _ = MESSAGE_HEAD.unpack_from(part.content)
            (row,) = rows = TICK.array(bytearray(part.content[MESSAGE_HEAD.size :]))
            epoch_ns = log_time - int(row["time_ns"])
            change(row)
            times = [epoch_ns + int(row["time_ns"])] * 2
            parts[at] = container.record(5, MESSAGE_HEAD.pack(channel, sequence, *times) + rows.tobytes())
    raw = b"".join(map(bytes, parts))
    return container.chunk(raw, len(raw), "", zlib.crc32(raw))


@pytest.mark.parametrize(
    ("number", "changed_to", "later_ns", "kept"),
    [
        (20, 19, 0, False),
        (20, 20, 0, True),
        (20, 20, -5_000_000, True),
        (20, 20, -5_000_001, False),
        (25, 24, 0, False),
        (25, 25, -5_000_000, True),
        (25, 25, -5_000_001, False),
    ],
)
def test_a_chunk_whose_ticks_do_not_follow_one_another_is_refused(
    rescue, container, pieces, number, changed_to, later_ns, kept
):
    def change(row):
        if row["tick"] == number:
            row["tick"] = changed_to
            row["time_ns"] = int(row["time_ns"]) + later_ns

    records, chunks = pieces
    records[chunks[3]] = altered_chunk(container, records[chunks[3]], change)
    recovery, session = rescue(joined(container, records))
    assert (len(session.ticks) == 60) is kept
    assert any("repeats earlier" in loss for loss in recovery.losses) is not kept


def test_a_complete_session_reports_no_loss(rescue, short):
    recovery, _ = rescue(short.read_bytes())
    assert recovery.losses == ()
    assert recovery.card["explanation"] == "recovered from altered.mcap"


def test_data_whose_own_checksum_is_wrong_are_not_said_to_be_whole(rescue, container, pieces):
    records, _ = pieces
    at = next(at for at, record in enumerate(records) if record.opcode == DATA_END)
    records[at] = container.record(DATA_END, struct.pack("<I", 12345))
    recovery, session = rescue(joined(container, records))
    (loss,) = recovery.losses
    assert "checksum" in loss
    assert loss in recovery.card["explanation"]
    assert len(session.ticks) == 60


def test_ticks_that_are_not_those_that_were_recorded_are_named(rescue, container, pieces):
    def change(row):
        row["brake_request"] += 0.5

    records, chunks = pieces
    records[chunks[3]] = altered_chunk(container, records[chunks[3]], change)
    recovery, _ = rescue(container.join(records))
    assert recovery.losses == ("the ticks do not match the hash that was recorded with them",)


def test_ticks_whose_hash_is_lost_are_said_to_be_perhaps_not_all(rescue, container, pieces):
    records, _ = pieces
    kept = [record for record in records if record.opcode != METADATA or b"payload_sha256" not in record.content]
    assert len(kept) < len(records)
    recovery, _ = rescue(container.join(kept))
    assert "no hash says that these are all of the ticks" in recovery.losses


@pytest.mark.parametrize(("log_time", "words"), [(2**63, "not valid dates"), (2**63 - 1, "two clocks do not match")])
def test_a_chunk_whose_times_no_clock_shows_gives_no_tick(rescue, container, pieces, log_time, words):
    records, chunks = pieces
    dated = b"".join(
        bytes(e if e.opcode != 5 else container.record(5, e.content[:6] + struct.pack("<Q", log_time) + e.content[14:]))
        for e in container.split(container.unpack(records[chunks[3]]), 0)
    )
    records[chunks[3]] = container.chunk(dated, len(dated), "", zlib.crc32(dated))
    recovery, session = rescue(joined(container, records))
    assert session.ticks["tick"].tolist() == [*range(20), *range(30, 60)]
    assert any(words in loss for loss in recovery.losses)


def test_a_chunk_that_is_refused_in_its_middle_leaves_no_trace(rescue, container, pieces):
    records, chunks = pieces
    entries = container.split(container.unpack(records[chunks[6]]), 0)
    *rest, last = entries
    wrong = container.record(5, last.content[:6] + bytes(8) + last.content[14:])  # a truth of another time
    raw = b"".join(map(bytes, [*rest, wrong]))
    records.insert(chunks[2], container.chunk(raw, len(raw), "", zlib.crc32(raw)))
    assert rescue(joined(container, records))[1].ticks["tick"].tolist() == list(range(60))


def test_metadata_attachments_and_times_are_the_originals(rescue, short):
    recovery, session = rescue(short.read_bytes()[:-400])
    whole = read_session(short)
    assert session.attachments == whole.attachments
    assert session.epoch_ns == whole.epoch_ns
    for name in ("rig", "controller"):
        assert session.metadata[name] == whole.metadata[name]
    for key in ("session_id", "started_utc", "ended_utc"):
        assert session.metadata["session"][key] == whole.metadata["session"][key]
    assert session.metadata["recovery"]["outcome"] == "completed"
    assert session.metadata["session"]["outcome"] == recovery.card["outcome"] == "recovered"
    assert session.log == whole.log


def test_the_outcome_of_the_original_is_not_beside_that_of_the_recovery(rescue, officially, short, tmp_path):
    rescue(short.read_bytes()[:-400])
    records = [
        each.metadata for each in officially(tmp_path / "out.mcap").metadata if each.name == "inteco_abs.session"
    ]
    assert [each["outcome"] for each in records if "outcome" in each] == ["recovered"]
    assert len([each for each in records if "ticks" in each]) == 1


def test_a_single_tick_that_is_missing_is_named(rescue, short, tmp_path):
    session = read_session(short)
    with FileWriter(tmp_path / "gap.mcap", int(session.ticks["time_ns"][0])) as recorder:
        recorder.begin({})
        recorder.ticks(session.ticks[:30].tobytes())
        recorder.ticks(session.ticks[31:].tobytes())
        recorder.flush()
    assert rescue((tmp_path / "gap.mcap").read_bytes())[0].missing == ((30, 30),)


@pytest.mark.parametrize("ticks", [60, 20, 7])
def test_in_however_many_blocks_it_is_copied_nothing_is_left_out(rescue, short, tmp_path, monkeypatch, ticks):
    monkeypatch.setattr(recovery, "_BLOCK_TICKS", ticks)
    session = read_session(short)
    times = session.epoch_ns + session.ticks["time_ns"].astype(int)
    with FileWriter(tmp_path / "damaged.mcap", int(session.ticks["time_ns"][0]), epoch_ns=session.epoch_ns) as recorder:
        recorder.begin({})
        recorder.ticks(session.ticks.tobytes())
        recorder.truths(session.truth.tobytes())
        for at in (5, 30, 59):
            recorder.warn(int(times[at]) + 1, f"after tick {at}")
        recorder.flush()
    recovered = rescue((tmp_path / "damaged.mcap").read_bytes())[1]
    assert recovered.ticks.tobytes() == session.ticks.tobytes()
    assert recovered.truth.tobytes() == session.truth.tobytes()
    assert [event.text for event in recovered.log if "after" in event.text] == [
        f"after tick {at}" for at in (5, 30, 59)
    ]


def test_truths_behind_the_last_tick_are_kept(rescue, short, tmp_path):
    session = read_session(short)
    with FileWriter(tmp_path / "long.mcap", int(session.ticks["time_ns"][0])) as recorder:
        recorder.begin({})
        recorder.ticks(session.ticks[:50].tobytes())
        recorder.truths(session.truth.tobytes())
        recorder.flush()
    recovered = rescue((tmp_path / "long.mcap").read_bytes())[1]
    assert (len(recovered.ticks), len(recovered.truth)) == (50, 60)


def test_the_controllers_internals_keep_their_names(rescue, short, tmp_path):
    names = ["s", "sigma", "", "c3"]
    session = read_session(short)
    declared = [Quantity(name, "N.m", "a torque") for name in names]
    start_ns, gains = int(session.ticks["time_ns"][0]), [Quantity("Mk", "1/s", "a rate")]
    with FileWriter(tmp_path / "named.mcap", start_ns, internals=declared, gains=gains) as recorder:
        recorder.begin({})
        recorder.ticks(session.ticks.tobytes())
        recorder.flush()
    recovered = rescue((tmp_path / "named.mcap").read_bytes())[1]
    assert internals_of(recovered.channels) == tuple(declared)
    assert gains[0] in gains_of(recovered.channels)


def test_the_metrics_are_those_of_the_original(quick, altered, tmp_path):
    data = quick.path.read_bytes()
    recovery = recover_session(altered(data[:-400]), tmp_path / "out.mcap")
    changed = {"session", "outcome", "reason", "explanation"}
    kept = {key: value for key, value in quick.stop.card.items() if key not in changed}
    assert {key: recovery.card[key] for key in kept} == kept


def test_a_session_that_was_cut_has_ended_with_its_last_tick(rescue, cut_short):
    recovery, session = rescue(cut_short)
    assert any(f"..{len(cut_short) - 1}: " in loss for loss in recovery.losses)
    assert session.metadata["session"]["ended_utc"] == utc(session.epoch_ns + int(session.ticks["time_ns"][-1]))


def test_what_the_recovery_wrote_opens_officially(rescue, officially, cut_short, tmp_path):
    rescue(cut_short)
    found = officially(tmp_path / "out.mcap")
    assert len(found.of("/abs/tick")) == len(read_session(tmp_path / "out.mcap").ticks) > 20


def with_another_attachment(container, records):
    """A byte of the configuration changed, its checksum right."""
    at = next(at for at, record in enumerate(records) if record.opcode == ATTACHMENT)
    content = records[at].content[:-4].replace(b"sim_usb2", b"sim_usb3")
    records[at] = container.record(ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))
    return container.join(records)


def test_an_attachment_that_is_not_the_one_that_was_recorded_is_left_out(rescue, container, pieces):
    recovery, session = rescue(with_another_attachment(container, pieces[0]))
    assert recovery.losses == ("attachment 'config.toml' does not match the hash that was recorded with it",)
    assert (len(session.ticks), "config.toml" in session.attachments) == (60, False)


def test_an_attachment_that_is_not_the_one_that_was_recorded_is_wrong(container, pieces, altered):
    inspection = validate(altered(with_another_attachment(container, pieces[0])))
    assert inspection.verdict == "wrong"
    assert [f.place for f in inspection.findings] == ["attachment config.toml"]


def test_without_its_configuration_a_session_has_no_metrics_but_its_ticks(rescue, container, pieces):
    records, _ = pieces
    kept = [record for record in records if record.opcode != ATTACHMENT]
    recovery, session = rescue(joined(container, kept))
    assert len(session.ticks) == 60
    assert (recovery.card["controller"], recovery.card["stop_time_s"]) == (None, None)


def test_a_missing_end_is_named_when_the_file_gives_its_length(rescue, container, pieces):
    records, chunks = pieces
    del records[chunks[-2]]  # the last one has the result
    assert rescue(joined(container, records))[0].missing == ((50, 59),)


def test_a_recovery_of_a_recovery_remembers_what_was_lost(rescue, cut_short, tmp_path):
    rescue(cut_short)
    recover_session(tmp_path / "out.mcap", tmp_path / "again.mcap")
    assert "no end" in read_session(tmp_path / "again.mcap").metadata["recovery"]["lost"]
    assert validate(tmp_path / "again.mcap").verdict == "losses"


@pytest.mark.parametrize("share", [0.0, 0.01, 0.1, 0.5, 1.0])
def test_a_file_without_a_whole_tick_is_refused_and_nothing_is_left(altered, short, pieces, tmp_path, share):
    records, chunks = pieces
    length = round(share * (records[chunks[1]].end - 1))
    source = altered(short.read_bytes()[:length])
    with pytest.raises(SessionError, match="has no intact tick"):
        recover_session(source, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [source]


def test_a_session_of_another_version_is_refused_and_says_so(container, pieces, altered, tmp_path):
    records, chunks = pieces
    raw = container.unpack(records[chunks[0]]).replace(b"wheel_count", b"wheel_cound")
    records[chunks[0]] = container.chunk(raw, len(raw), "", zlib.crc32(raw))
    with pytest.raises(SessionError, match="another version of this program"):
        recover_session(altered(joined(container, records)), tmp_path / "out.mcap")


def test_the_source_is_never_overwritten(short, tmp_path):
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(short.read_bytes())
    with pytest.raises(ConfigError, match="never overwritten"):
        recover_session(copy, copy)
    assert copy.read_bytes() == short.read_bytes()


@pytest.mark.parametrize(("bytes_left", "words"), [(5_000, "has no room"), (14_000, "cannot be written")])
def test_a_full_disk_leaves_nothing(short, tmp_path, room, bytes_left, words):
    room(bytes_left)
    with pytest.raises(SessionError, match=words):
        recover_session(short, tmp_path / "out.mcap")
    room(-1)
    assert list(tmp_path.iterdir()) == []


def bounded(data, altered, tmp_path):
    """Recovering from hostile bytes costs little memory."""
    path = altered(data)
    tracemalloc.start()
    try:
        with pytest.raises(SessionError, match="nothing to recover"):
            recover_session(path, tmp_path / "out.mcap")
        validate(path)
        assert tracemalloc.get_traced_memory()[1] < 8_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("length", [1 << 16, 1 << 32, (1 << 64) - 1])
def test_a_thousand_heads_that_claim_too_much(container, altered, tmp_path, length):
    bounded(container.magic + struct.pack("<BQ", CHUNK, length) * 1000, altered, tmp_path)


def test_chunks_that_unpack_to_far_more_than_the_file_has(container, altered, tmp_path):
    import zstandard

    packed = zstandard.ZstdCompressor().compress(bytes(1 << 20))
    bomb = container.chunk(packed, 1 << 20, "zstd", zlib.crc32(bytes(1 << 20)))
    bounded(container.magic + bytes(bomb) * 200, altered, tmp_path)


def test_a_search_among_false_heads_is_given_up(altered, container, tmp_path, short):
    false = struct.pack("<BQ", CHUNK, 1 << 19) + bytes(55)
    data = container.magic + false * 20_000
    with pytest.raises(SessionError, match="given up"):
        recover_session(altered(data + short.read_bytes()), tmp_path / "out.mcap")


def test_a_declaration_is_looked_at_once_however_many_there_are(rescue, container, pieces, monkeypatch):
    looked_at = []
    monkeypatch.setattr(content, "message_layout", lambda *given: looked_at.append(given) or message_layout(*given))
    records, chunks = pieces
    declared = next(part for part in container.split(container.unpack(records[chunks[0]]), 0) if part.opcode == CHANNEL)
    number = 100
    for at in chunks:
        raw = b""
        for part in container.split(container.unpack(records[at]), 0):
            raw += bytes(declared._replace(content=struct.pack("<H", number) + declared.content[2:])) + bytes(part)
            number += 1
        records[at] = container.chunk(raw, len(raw), "", zlib.crc32(raw))
    assert len(rescue(container.join(records))[1].ticks) == 60
    assert number > 200
    assert len(looked_at) < 2 * number


def test_parameters_are_published_again(rescue, officially, short, tmp_path):
    rescue(short.read_bytes())
    ((_, _, _, parameters),) = officially(tmp_path / "out.mcap").of("/abs/params")
    facts = read_session(short).metadata["controller"]
    assert parameters.values["reference_slip"] == float(facts["reference_slip"])
    assert parameters.values["Mk"] == float(facts["gain.Mk"])


def test_the_log_is_the_originals_with_its_warnings(tmp_path, tiny):
    session, source = tiny.session, tmp_path / "warned.mcap"
    half = len(session.ticks) // 2
    with FileWriter(source, int(session.ticks["time_ns"][0]), epoch_ns=session.epoch_ns) as recorder:
        recorder.begin({})
        recorder.ticks(session.ticks[:half].tobytes())
        recorder.warn(session.epoch_ns + int(session.ticks["time_ns"][half]), "the disk is slow")
        recorder.ticks(session.ticks[half:].tobytes())
        recorder.flush()
    recover_session(source, tmp_path / "out.mcap")
    log = read_session(tmp_path / "out.mcap").log
    assert log == read_session(source).log
    assert "the disk is slow" in [event.text for event in log]
    assert len(log) > 3


def test_a_line_of_the_log_that_cannot_be_read_costs_no_tick(rescue, container, pieces):
    records, chunks = pieces
    line = container.record(5, struct.pack("<HIQQ", EVENTS, 0, 0, 0) + b"\xff")
    raw = container.unpack(records[chunks[2]]) + bytes(line)
    records[chunks[2]] = container.chunk(raw, len(raw), "", zlib.crc32(raw))
    recovery, session = rescue(joined(container, records))
    assert len(session.ticks) == 60
    assert any("an event cannot be read" in loss for loss in recovery.losses)


def test_the_disk_has_all_of_it_before_it_gets_its_name(short, tmp_path, monkeypatch):
    out, at_the_last = tmp_path / "out.mcap", []
    monkeypatch.setattr(os, "fdatasync", lambda number: at_the_last.append((os.fstat(number).st_size, out.exists())))
    recover_session(short, out)
    assert at_the_last[-1] == (out.stat().st_size, False)


def test_gaps_are_in_the_metadata_as_numbers(rescue, container, pieces):
    records, chunks = pieces
    del records[chunks[2]]
    _, session = rescue(joined(container, records))
    assert json.loads(session.metadata["recovery"]["missing_ticks"]) == [[10, 19]]
    assert session.ticks.dtype == TICK.dtype
