"""The raw frames of a run in its session: as the capture of the same run has them, and without disturbing it."""

import zlib
from contextlib import nullcontext

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.errors import CaptureError, ConfigError, SessionError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.format.io_frame import IO_NAME, Direction, IoFrame, io_frame_descriptor, pack_io_frame, unpack_io_frame
from inteco_abs.realtime import memory
from inteco_abs.realtime.processes.recorder import recover_run
from inteco_abs.sessions import (
    FileWriter,
    RunEnd,
    RunHeader,
    SessionWriter,
    read_frames,
    read_session,
    recover_session,
    validate,
)
from inteco_abs.sessions.frames import frame_facts, packed_frames
from inteco_abs.signals import Reason
from inteco_abs.wire.capture import Capture, Record, RecordKind, read_capture

TOPIC = "/rig/io"
SETTINGS = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")


@pytest.fixture(scope="module")
def framed(tmp_path_factory, run_at):
    """A stop with its raw frames, which fill more than two chunks; its capture lies beside it."""
    folder = tmp_path_factory.mktemp("framed")
    return run_at(folder / "stop.mcap", SETTINGS, frames=True, wire=folder / "wire.jsonl")


@pytest.fixture(scope="module")
def capture(framed):
    return read_capture(framed.path.with_name("wire.jsonl"))


@pytest.fixture(scope="module")
def bare(tmp_path_factory, run_at):
    """The same stop without."""
    return run_at(tmp_path_factory.mktemp("bare") / "stop.mcap", SETTINGS)


@pytest.fixture(scope="module")
def chunks(framed, container):
    """Chunks of the stop that hold frames."""
    found = [record for record in container.split(framed.path.read_bytes()) if record.opcode == 6]
    sizes = [len(container.unpack(chunk)) for chunk in found]
    first = next(at for at, chunk in enumerate(found) if TOPIC.encode() in container.unpack(chunk))
    assert len(sizes) - first > 3
    return found[first:-1]


def frames_in(chunk, container):
    return sum(record.opcode == 5 for record in container.split(container.unpack(chunk), 0))


class TestOut:
    def test_what_import_writes_is_what_the_capture_of_the_run_has_byte_for_byte(self, framed, verb, tmp_path):
        assert verb("wire", "import", framed.path, "-o", tmp_path / "again.jsonl").code == 0
        assert (tmp_path / "again.jsonl").read_bytes() == framed.path.with_name("wire.jsonl").read_bytes()

    def test_the_verbs_of_wire_take_the_session_itself(self, framed, verb):
        wire = framed.path.with_name("wire.jsonl")
        assert verb("wire", "diff", framed.path, wire).code == 0
        shown, captured = (verb("wire", "show", path, "--json").json for path in (framed.path, wire))
        assert {**shown, "capture": ""} == {**captured, "capture": ""}

    def test_a_session_without_frames_says_how_to_get_them(self, bare, verb):
        refused = verb("wire", "show", bare.path)
        assert refused.code == 1
        assert "has no raw frames: record them with inteco-abs run --frames" in refused.err

    def test_a_file_that_is_not_there_is_named(self, verb, tmp_path):
        refused = verb("wire", "show", tmp_path / "none.mcap")
        assert refused.code == 1
        assert "none.mcap: cannot be read" in refused.err


class TestInTheSession:
    def test_the_official_libraries_decode_every_frame(self, framed, capture, officially):
        found = officially(framed.path).of(TOPIC)
        assert {schema.name for schema, *_ in found} == {IO_NAME}
        epoch_ns = framed.session.epoch_ns
        assert [
            (decoded.direction, decoded.data, decoded.text, decoded.of, decoded.time_ns) for *_, decoded in found
        ] == [
            (Direction[one.kind.name], one.data, one.text, one.of, capture.start_ns + round(one.t_s * 1e9))
            for one in capture.records
        ]
        assert [message.log_time - epoch_ns for _, _, message, _ in found] == [each.time_ns for *_, each in found]
        assert [message.sequence for _, _, message, _ in found] == list(range(len(found)))

    def test_frames_follow_the_last_tick_and_precede_the_result(self, framed, officially):
        topics = [channel.topic for _, channel, *_ in officially(framed.path).messages]
        frames = topics.count(TOPIC)
        first = topics.index(TOPIC)
        assert topics[first:] == [TOPIC] * frames + ["/abs/result"]

    def test_they_are_counted_and_nothing_else_is_changed_by_them(self, framed, bare, capture, verb):
        with_frames, without = framed.session, bare.session
        assert (with_frames.frames, without.frames) == (len(capture.records), 0)
        assert with_frames.ticks.tobytes() == without.ticks.tobytes()
        assert with_frames.truth.tobytes() == without.truth.tobytes()
        assert framed.stop.card["payload_sha256"] == bare.stop.card["payload_sha256"]
        assert verb("info", framed.path, "--json").json["frames"] == len(capture.records)
        assert "frames" not in without.metadata

    def test_reading_the_session_keeps_none_of_them(self, framed, monkeypatch):
        def read(*_):
            raise AssertionError("a frame was read")

        monkeypatch.setattr("inteco_abs.sessions.container.VariableRun.messages", read)
        assert read_session(framed.path).frames

    @pytest.mark.parametrize("virtual", [True, False], ids=["virtual", "real time"])
    def test_a_board_with_registers_is_refused_before_anything_is_made(self, tmp_path, virtual):
        plan = Plan(tmp_path / "stop.mcap", virtual=virtual, frames=True)
        with pytest.raises(ConfigError, match="--frames: a pci board has registers"):
            run_stop(load_config(settings=["profile=sim_pci"]), plan)
        assert not list(tmp_path.iterdir())


class TestDamage:
    def test_a_whole_session_is_well(self, framed):
        assert validate(framed.path).findings == []

    def test_a_changed_bit_in_a_frame_is_found(self, framed, chunks, altered):
        data = bytearray(framed.path.read_bytes())
        data[chunks[1].end - 20] ^= 1
        found = validate(altered(bytes(data)))
        assert found.verdict == "wrong"
        assert any(finding.place.startswith(f"bytes {chunks[1].at}..") for finding in found.findings)

    def test_frames_that_are_missing_are_found_by_their_number(self, framed, chunks, container, altered):
        records = container.split(framed.path.read_bytes())
        kept = [record for record in records if record.at != chunks[1].at]
        problems = [finding.problem for finding in validate(altered(container.join(kept))).findings]
        number = framed.session.frames
        left = number - frames_in(chunks[1], container)
        assert f"it says {number} raw frames, the file has {left}" in problems

    def test_recover_keeps_the_whole_frames_of_a_cut_file(self, framed, capture, chunks, container, altered, tmp_path):
        cut = altered(framed.path.read_bytes()[: chunks[2].end - 1])
        recovery = recover_session(cut, tmp_path / "out.mcap")
        assert not any("raw frames" in loss for loss in recovery.losses)
        kept = frames_in(chunks[0], container) + frames_in(chunks[1], container)
        again = read_frames(tmp_path / "out.mcap")
        assert again._replace(name="", records=()) == capture._replace(name="", records=())
        assert again.records[:-1] == capture.records[:kept]
        assert "the file no longer has their number" in again.records[-1].text
        *before, warning = read_frames(cut).records
        assert tuple(before) == capture.records[:kept]
        assert (warning.kind, warning.t_s) == (RecordKind.WARNING, before[-1].t_s)
        assert warning.text == "the session may lack messages: the file ends early"
        session = read_session(tmp_path / "out.mcap")
        assert session.ticks.tobytes() == framed.session.ticks.tobytes()
        assert session.metadata["frames"]["messages"] == str(kept)
        assert "missing" in session.metadata["frames"]

    def test_recover_says_how_many_frames_a_damaged_chunk_has_cost(
        self, framed, chunks, container, altered, officially, tmp_path
    ):
        data = bytearray(framed.path.read_bytes())
        data[chunks[1].end - 20] ^= 1
        recovery = recover_session(altered(bytes(data)), tmp_path / "out.mcap")
        lost = frames_in(chunks[1], container)
        assert f"{lost} raw frames are missing" in recovery.losses
        assert recovery.missing == ()
        left = framed.session.frames - lost
        assert len(read_frames(tmp_path / "out.mcap").records) == left
        described = [
            record.metadata for record in officially(tmp_path / "out.mcap").metadata if "frames" in record.name
        ]
        assert described == [{"messages": str(left)}]

    def test_recover_of_a_file_that_has_lost_all_frames_says_how_many_there_were(
        self, framed, chunks, container, altered, tmp_path
    ):
        gone = {chunk.at for chunk in chunks}
        records = [record for record in container.split(framed.path.read_bytes()) if record.at not in gone]
        recovery = recover_session(altered(container.join(records)), tmp_path / "out.mcap")
        assert f"{framed.session.frames} raw frames are missing" in recovery.losses
        assert read_session(tmp_path / "out.mcap").metadata["frames"] == {"messages": "0"}

    def test_recover_of_a_whole_session_loses_no_frame(self, framed, tmp_path):
        assert recover_session(framed.path, tmp_path / "out.mcap").losses == ()

    def test_a_single_frame_that_comes_twice_is_kept_once(self, framed, capture, chunks, container, altered, tmp_path):
        records = container.split(framed.path.read_bytes())
        first = next(at for at, record in enumerate(records) if record.at == chunks[0].at)
        newest = bytes(container.split(container.unpack(records[first]), 0)[-1])
        records.insert(first + 1, container.chunk(newest, len(newest), "", zlib.crc32(newest)))
        recovery = recover_session(altered(container.join(records)), tmp_path / "out.mcap")
        assert any("repeats earlier" in loss for loss in recovery.losses)
        assert read_frames(tmp_path / "out.mcap").records == capture.records

    def test_frames_that_come_twice_are_kept_once(self, framed, capture, chunks, container, altered, tmp_path):
        records = container.split(framed.path.read_bytes())
        again = next(at for at, record in enumerate(records) if record.at == chunks[1].at)
        doubled = altered(container.join([*records[: again + 1], records[again], *records[again + 1 :]]))
        recovery = recover_session(doubled, tmp_path / "out.mcap")
        assert any("repeats earlier" in loss for loss in recovery.losses)
        assert read_frames(tmp_path / "out.mcap").records == capture.records

    @pytest.mark.parametrize(
        ("facts", "message"),
        [
            ({}, b""),
            ({"start_ns": "x"}, b""),
            ({"start_ns": "9" * 4000}, pack_io_frame(IoFrame(1, Direction.OUT))),
            ({"start_ns": "0"}, b"\xff"),
            ({"start_ns": "0"}, pack_io_frame(IoFrame(1, Direction.UNKNOWN))),
            ({"start_ns": "0"}, b"\x10\x63"),
            ({"start_ns": "0"}, b"\x08\x01\x10\x01"),
            ({"start_ns": "0"}, b"\x09" + bytes(8) + b"\x10\x01\x22\x01\xff"),
            ({"start_ns": "0"}, b"\x09" + bytes(8) + b"\x10\x01\x18\x01"),
        ],
    )
    def test_an_invalid_frame_is_refused_with_one_sentence(self, tmp_path, facts, message):
        with FileWriter(tmp_path / "x.mcap", 0) as recorder:
            head = {"board": "usb2", "recorded_by": "", "clock": ""} if facts else {}
            recorder.frames({**head, **facts}, [(0, message)])
        with pytest.raises(SessionError, match="is damaged: its raw frames cannot be read"):
            read_frames(tmp_path / "x.mcap")


@pytest.fixture
def concluded(tiny, tmp_path):
    """Records a short run with these frames."""
    session = tiny.session

    def record(frames):
        with FileWriter(tmp_path / "short.mcap", 0) as recorder:
            introduction = RunHeader("sim:", {}, virtual=True, gains={}, internals=[], controller_source=b"")
            scribe = SessionWriter(recorder, tiny.config, introduction)
            scribe.write_header()
            scribe.add(bytes(session.payload), b"")
            return scribe.finish(RunEnd(Reason.NONE, len(session.ticks), frames=frames))

    return record


def failing(head, records, error):
    def each():
        yield from records
        raise CaptureError(error)

    return lambda: nullcontext((head, each()))


def test_without_a_recording_the_session_is_whole_and_says_why_it_has_no_frames(concluded, tiny, tmp_path):
    def none():
        raise CaptureError("the loop's process ended before it had saved them")

    account = concluded(none)
    assert (account.outcome, account.exit_code) == ("completed", 3)
    assert "raw frames: the loop's process ended before it had saved them" in account.trouble
    session = read_session(tmp_path / "short.mcap")
    assert (session.incomplete, session.frames, len(session.ticks)) == ("", 0, len(tiny.session.ticks))
    assert session.metadata["frames"] == {"missing": "the loop's process ended before it had saved them"}
    assert "not all raw frames were kept" in validate(tmp_path / "short.mcap").findings[0].problem
    with pytest.raises(SessionError, match="has no raw frames: the loop's process ended"):
        read_frames(tmp_path / "short.mcap")


def test_a_recording_that_breaks_off_gives_the_frames_before_that(concluded, tmp_path):
    head = Capture("usb2", "by hand", "monotonic", (), "x", 5)
    records = (Record(0.0, RecordKind.OUT, None, b"o"), Record(1e-9, RecordKind.IN, None, b"i"))
    account = concluded(failing(head, records, "line 4 is wrong"))
    assert "line 4 is wrong" in account.trouble
    *before, warning = read_frames(tmp_path / "short.mcap").records
    assert tuple(before) == records
    assert "may lack messages: line 4 is wrong" in warning.text


def test_a_run_whose_disk_vanishes_has_its_frames_in_the_second_place(run, vanishing, capture, tmp_path):
    (tmp_path / "spill").mkdir()
    made = run(f"session.spill={tmp_path / 'spill'}", name=vanishing, frames=True)
    assert read_frames(tmp_path / "spill" / "stop.mcap").records == capture.records
    assert "raw frames" not in made.stop.trouble


def test_a_run_that_no_disk_takes_keeps_its_frames_in_memory(run, tmp_path, monkeypatch, vanishing):
    monkeypatch.setattr(memory, "FOLDER", tmp_path)
    with pytest.raises(SessionError, match="Its ticks are kept in"):
        run(name=vanishing, frames=True)
    (ring,) = tmp_path.glob("*.ring")
    recover_run(ring, tmp_path / "saved.mcap")
    capture = read_frames(tmp_path / "saved.mcap")
    assert (capture.board, capture.messages) == ("usb2", read_session(tmp_path / "saved.mcap").frames)
    assert not list(tmp_path.glob("*.frames"))


TIMES = st.integers(0, 10**15)
TEXTS = st.text(max_size=20)
FRAMES = st.builds(IoFrame, TIMES, st.sampled_from(list(Direction)[1:]), st.binary(max_size=600), TEXTS, TEXTS)


@pytest.fixture(scope="module")
def official(message_class):
    return message_class(io_frame_descriptor(), IO_NAME)


@given(frame=FRAMES)
def test_a_frame_is_what_the_official_library_makes_of_it(official, frame):
    theirs = official.FromString(pack_io_frame(frame))
    assert tuple(getattr(theirs, name) for name in IoFrame._fields) == tuple(frame)
    assert unpack_io_frame(theirs.SerializeToString()) == frame


@given(start_ns=TIMES, times=st.lists(TIMES))
def test_times_come_back_to_the_nanosecond(start_ns, times):
    head = Capture("usb2", "", "", (), "", start_ns)
    records = [Record(round(time_ns * 1e-9, 9), RecordKind.OUT) for time_ns in times]
    assert frame_facts(head)["start_ns"] == str(start_ns)
    assert [time_ns - start_ns for time_ns, _ in packed_frames(head, records)] == times
