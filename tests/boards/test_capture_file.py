import json
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.errors import CaptureError
from inteco_abs.wire.capture import (
    Capture,
    Record,
    RecordKind,
    check_target,
    open_capture,
    parse_capture,
    read_capture,
    write_capture,
)

HEAD = {"format": "inteco-abs wire", "version": 1, "board": "usb2", "recorded_by": "a test", "clock": "none"}
RECORDS = (
    Record(0.0, RecordKind.OUT, 2, b"\xff\x8f\x00\x00"),
    Record(0.00125, RecordKind.IN, 0x84, bytes(504)),
    Record(0.002, RecordKind.OUT, None, b""),
    Record(0.0125, RecordKind.ERROR, text="the board did not answer", of="in"),
    Record(0.02, RecordKind.ERROR, data=b"\x0f\x8f", text="unplugged: Größe", of="out"),
    Record(0.03, RecordKind.ERROR, text="unplugged", of="exchange"),
    Record(0.04, RecordKind.CONTROL, 0, b"12", setup=bytes(8)),
    Record(0.05, RecordKind.WARNING, text="something"),
)
times = st.integers(0, 10**13).map(lambda ns: ns * 1e-9)
directions = st.sampled_from([RecordKind.OUT, RecordKind.IN])
endpoints = st.none() | st.integers(0, 255)
messages = st.tuples(times, directions, endpoints, st.binary(max_size=40)).map(lambda parts: Record(*parts))


def lines(*records, **head):
    return [json.dumps({**HEAD, **head}), *(json.dumps(record) for record in records)]


def test_everything_that_is_written_is_read_again(tmp_path):
    path = tmp_path / "x.jsonl"
    capture = Capture("usb2", "a test", "none", RECORDS, str(path), 12_000_000_007)
    write_capture(path, capture)
    assert read_capture(path) == capture
    with open_capture(path) as (head, records):
        assert head._replace(records=tuple(records)) == capture
    assert [file.name for file in tmp_path.iterdir()] == ["x.jsonl"]


def test_the_file_is_what_the_format_says(tmp_path):
    path = tmp_path / "x.jsonl"
    write_capture(path, Capture("usb2", "a test", "none", RECORDS[:2]))
    head, out, answer = map(json.loads, path.read_text().splitlines())
    assert head == HEAD
    assert out == {"t": 0.0, "dir": "out", "ep": 2, "hex": "ff8f0000"}
    assert answer == {"t": 0.00125, "dir": "in", "ep": 132, "hex": "00" * 504}


@pytest.mark.untraced
@given(st.lists(messages, max_size=5))
def test_messages_keep_their_bytes_and_their_nanoseconds(tmp_path_factory, records):
    path = tmp_path_factory.mktemp("x") / "x.jsonl"
    write_capture(path, Capture("usb2", "", "", tuple(records)))
    for before, after in zip(records, read_capture(path).records, strict=True):
        assert after[1:] == before[1:]
        assert round(after.t_s * 1e9) == round(before.t_s * 1e9)


@pytest.mark.parametrize(
    ("head", "word"),
    [
        ({"format": "other"}, "format = 'other'"),
        ({"version": 2}, "version = 2, this program reads 1"),
        ({"board": 7}, "board = 7"),
        ({"clock": None}, "clock = None"),
        ({"start_ns": 1.5}, "start_ns = 1.5, must be in 0.."),
        ({"start_ns": -1}, "start_ns = -1"),
        ({"start_ns": 1 << 63}, "start_ns = 9223372036854775808"),
    ],
)
def test_a_wrong_header_is_named(head, word):
    with pytest.raises(CaptureError, match=f"x, line 1: {word}"):
        parse_capture(lines(**head), "x")


@pytest.mark.parametrize(
    ("record", "word"),
    [
        ({"t": 0, "dir": "up", "hex": ""}, "dir = 'up', must be one of out, in, error"),
        ({"t": 0, "dir": ["out"], "hex": ""}, "dir = "),
        ({"t": "0", "dir": "out", "hex": ""}, "t = '0'"),
        ({"t": True, "dir": "out", "hex": ""}, "t = True"),
        ({"t": float("nan"), "dir": "out", "hex": ""}, "t = nan"),
        ({"dir": "out", "hex": ""}, "t = None"),
        ({"t": 0, "dir": "out", "ep": 256, "hex": ""}, "ep = 256"),
        ({"t": 0, "dir": "out", "ep": "2", "hex": ""}, "ep = '2'"),
        ({"t": 0, "dir": "out", "hex": "0"}, "hex = '0'"),
        ({"t": 0, "dir": "in"}, "hex = 'None'"),
        ({"t": 0, "dir": "in", "hex": 12}, "hex = '12'"),
        ({"t": 0, "dir": "control", "hex": "", "setup": "xy"}, "setup = 'xy'"),
        ({"t": 0, "dir": "error", "text": "x"}, "of = ''"),
        ({"t": 0, "dir": "warning", "text": 1}, "text = 1"),
        ([], "not a JSON object"),
    ],
)
def test_a_wrong_line_is_named_with_its_value(record, word):
    with pytest.raises(CaptureError, match="x, line 3: ") as refusal:
        parse_capture(lines({"t": 0, "dir": "out", "hex": "00"}, record), "x")
    assert word in str(refusal.value)


@pytest.mark.untraced
@given(st.text(max_size=60) | st.recursive(st.none() | st.integers() | st.text(), st.lists).map(json.dumps))
def test_any_line_is_a_record_or_one_clear_error(line):
    for given_lines in ([line], [json.dumps(HEAD), line]):
        with pytest.raises(CaptureError, match="x, line "):
            parse_capture(given_lines, "x")


@given(
    st.fixed_dictionaries(
        {},
        optional={
            key: st.none()
            | st.booleans()
            | st.integers()
            | st.floats()
            | st.text(max_size=9)
            | st.sampled_from(RecordKind)
            for key in ("t", "dir", "ep", "hex", "text", "of", "setup")
        },
    )
)
def test_any_object_is_a_record_or_one_clear_error(record):
    try:
        records, problem = parse_capture(lines(record), "x").records, ""
    except CaptureError as error:
        records, problem = (), str(error)
    assert len(records) == 1 or problem.startswith("x, line 2: ")


def drained(path):
    with open_capture(path) as (_, records):
        return list(records)


def test_a_file_that_is_read_record_by_record_is_refused_where_it_is_wrong(tmp_path):
    path = tmp_path / "x.jsonl"
    with pytest.raises(CaptureError, match=r"x\.jsonl: cannot be read: .*No such file"):
        drained(path)
    path.write_text("\n".join(lines({"t": 0, "dir": "out", "hex": "00"}, {"t": 0, "dir": "up"})))
    with pytest.raises(CaptureError, match=r"x\.jsonl, line 3: dir = 'up'"):
        drained(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(CaptureError, match=r"x\.jsonl: cannot be read"):
        drained(path)


def test_a_file_that_was_cut_off_is_refused(tmp_path):
    path = tmp_path / "x.jsonl"
    path.write_text("\n".join(lines({"t": 0, "dir": "out", "hex": "00"})))
    with pytest.raises(CaptureError, match="cut off"):
        read_capture(path)


@pytest.mark.parametrize(
    ("data", "word"),
    [(b"\xd4\xc3\xb2\xa1\n", "run inteco-abs wire import first"), (b"", "line 1"), (b"\n", "line 1")],
)
def test_files_other_than_captures_are_refused(tmp_path, data, word):
    path = tmp_path / "x.jsonl"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=word):
        read_capture(path)


def test_a_missing_file_is_a_clear_error(tmp_path):
    with pytest.raises(CaptureError, match="No such file"):
        read_capture(tmp_path / "x.jsonl")


@pytest.mark.parametrize("read", [read_capture, lambda path: open_capture(path).__enter__()])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, read):
    os.mkfifo(tmp_path / "x.jsonl")
    with pytest.raises(CaptureError, match="not a regular file"):
        read(tmp_path / "x.jsonl")


def test_captures_are_never_overwritten_and_need_their_folder(tmp_path):
    (tmp_path / "x.jsonl").write_text("precious")
    with pytest.raises(CaptureError, match="never overwritten"):
        check_target(tmp_path / "x.jsonl")
    with pytest.raises(CaptureError, match="does not exist"):
        check_target(tmp_path / "nowhere" / "x.jsonl")
    check_target(tmp_path / "new.jsonl")


def test_a_full_disk_is_a_clear_error():
    from pathlib import Path

    with pytest.raises(CaptureError, match="cannot be written"):
        write_capture(Path("/proc/x.jsonl"), Capture("usb2", "", "", ()))


class TestWhatIsThereAlready:
    """Under the name that a capture has until it is whole."""

    @pytest.fixture(params=["file", "link", "dangling link"])
    def victim(self, request, tmp_path):
        victim, part = tmp_path / "victim", tmp_path / "wire.jsonl.part"
        if request.param != "dangling link":
            victim.write_text("mine")
        if request.param == "file":
            part.write_text("mine")
            return part
        part.symlink_to(victim)
        return victim

    @pytest.mark.usefixtures("victim")
    def test_it_is_refused_before_anything_is_recorded(self, tmp_path):
        with pytest.raises(CaptureError, match=r"wire\.jsonl\.part, under which it would be written, exists already"):
            check_target(tmp_path / "wire.jsonl")

    def test_it_is_neither_truncated_nor_followed_nor_removed(self, victim, tmp_path):
        before = victim.read_text() if victim.exists() else None
        with pytest.raises(CaptureError, match=r"wire\.jsonl\.part: File exists; choose another name"):
            write_capture(tmp_path / "wire.jsonl", Capture("usb2", "a test", "monotonic", ()))
        assert (victim.read_text() if victim.exists() else None) == before
        assert (tmp_path / "wire.jsonl.part").is_symlink() or before == "mine"
