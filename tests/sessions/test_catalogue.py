"""A folder of sessions: every file is a row, however broken, and whole ones are not read through."""

import os
import random

import pytest

from inteco_abs.analysis import COLUMNS, session_files, session_row, sort_rows
from inteco_abs.errors import SessionError
from inteco_abs.sessions import read_session


@pytest.fixture
def folder(tmp_path):
    """Names to bytes, as files in a folder."""
    (tmp_path / "sessions").mkdir()

    def fill(**files):
        for name, data in files.items():
            (tmp_path / "sessions" / f"{name}.mcap").write_bytes(data)
        return tmp_path / "sessions"

    return fill


def rows_of(folder, **options):
    return {row["session"].rpartition("/")[2]: row for row in map(session_row, session_files(folder, **options))}


def test_a_row_has_what_the_card_and_the_metadata_say(quick):
    row = session_row(quick.path)
    card, facts = quick.stop.card, quick.session.metadata
    assert tuple(row)[: len(COLUMNS)] == COLUMNS
    assert row["torque_variation_nm_per_s"] == card["torque_variation_nm_per_s"]
    assert row["started_utc"] == facts["session"]["started_utc"]
    assert (row["outcome"], row["controller"], row["estimator"]) == ("completed", "reaching-law", "moving-window")
    for name in ("ticks", "slip_rms_true", "slip_rms_estimated", "band_entry_s", "stop_time_s", "overruns"):
        assert row[name] == card[name]
    assert (row["board"], row["rig"], row["lost_ticks"], row["problem"]) == ("sim:", None, 0, None)


def test_a_whole_file_is_listed_without_its_ticks(folder, container, short):
    records = container.split(short.read_bytes())
    chunk = next(record for record in records[::-1] if record.opcode == 6)
    data = bytearray(short.read_bytes())
    data[chunk.at + 60 : chunk.end] = bytes(chunk.end - chunk.at - 60)
    rows = rows_of(folder(whole=short.read_bytes(), hollow=bytes(data)))
    rows["hollow.mcap"]["session"] = rows["whole.mcap"]["session"]
    assert rows["hollow.mcap"] == rows["whole.mcap"]


def test_a_cut_file_is_read_and_judged_by_what_it_has(folder, quick, before_its_ticks):
    data = quick.path.read_bytes()
    rows = rows_of(folder(whole=data, cut=data[:-500], started=before_its_ticks(data)))
    assert rows["cut.mcap"]["ticks"] == rows["whole.mcap"]["ticks"]
    assert rows["cut.mcap"]["stop_time_s"] == rows["whole.mcap"]["stop_time_s"]
    assert "ends early" in rows["cut.mcap"]["problem"]
    started = rows["started.mcap"]
    assert (started["outcome"], started["controller"], started["ticks"]) == ("incomplete", "reaching-law", 0)


def test_the_card_of_a_cut_session_is_computed(altered, quick, container):
    records = container.split(quick.path.read_bytes())
    last = max(at for at, record in enumerate(records) if record.opcode == 6)
    row = session_row(altered(container.magic + b"".join(map(bytes, records[: last + 1]))))
    assert row["stop_time_s"] == quick.stop.card["stop_time_s"]
    assert row["outcome"] == "incomplete"


def test_broken_files_are_rows_with_their_problem(folder, short, container, with_a_flipped_bit):
    damaged = with_a_flipped_bit(short.read_bytes())[:-300]
    path = folder(empty=b"", text=b"not a session", foreign=container.craft(), damaged=damaged, good=short.read_bytes())
    os.mkfifo(path / "pipe.mcap")
    (path / "dangling.mcap").symlink_to("nowhere")
    (path / "folder.mcap").mkdir()
    (path / "notes.txt").write_text("no session by its name")
    rows = rows_of(path)
    problems = {name: row["problem"] for name, row in rows.items()}
    assert "is empty" in problems["empty.mcap"]
    assert "not an MCAP file" in problems["text.mcap"]
    assert "not a session of this program" in problems["foreign.mcap"]
    assert "is damaged: chunk at byte" in problems["damaged.mcap"]
    assert "not a regular file" in problems["pipe.mcap"]
    assert "No such file" in problems["dangling.mcap"]
    assert problems.pop("good.mcap") is None
    assert {rows[name]["outcome"] for name in problems} == {"broken"}
    assert set(rows) == {*problems, "good.mcap"}


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_index_is_not_accepted(altered, short, seed):
    generator = random.Random(seed)
    data = bytearray(short.read_bytes())
    data[generator.randrange(len(data) - 4000, len(data))] ^= generator.randrange(1, 256)
    whole, row = session_row(short), session_row(altered(bytes(data)))
    kept = [name for name in COLUMNS if name not in {"session", "problem"}]
    assert row["outcome"] == "broken" or [row[name] for name in kept] == [whole[name] for name in kept]


def test_an_index_that_names_another_place_is_not_followed(altered, container, short):
    records = container.split(short.read_bytes())
    places = {r.content[20:].decode(): at for at, r in enumerate(records) if r.opcode == 13}
    card, other = (places[f"inteco_abs.{name}"] for name in ("result", "integrity"))
    records[card] = records[card]._replace(content=records[other].content[:16] + records[card].content[16:])
    whole, row = session_row(short), session_row(altered(container.join(records)))
    assert (row["outcome"], row["stop_time_s"], row["ticks"]) == ("completed", whole["stop_time_s"], 60)
    assert row["problem"] == "its index is damaged"


def test_rows_are_sorted_and_those_without_a_value_are_last():
    rows = [dict.fromkeys(COLUMNS) | {"stop_time_s": value} for value in (2.0, None, 1.0, 3.0)]
    assert [row["stop_time_s"] for row in sort_rows(rows, "stop_time_s")] == [1.0, 2.0, 3.0, None]
    assert [row["stop_time_s"] for row in sort_rows(rows, "stop_time_s", reverse=True)] == [3.0, 2.0, 1.0, None]


def test_nested_folders_are_listed_on_request(folder, short):
    path = folder(top=short.read_bytes())
    (path / "older").mkdir()
    (path / "older" / "below.mcap").write_bytes(short.read_bytes())
    assert set(rows_of(path)) == {"top.mcap"}
    assert set(rows_of(path, nested=True)) == {"top.mcap", "below.mcap"}


def test_a_path_that_is_not_a_folder_is_refused(tmp_path):
    with pytest.raises(SessionError, match="cannot be listed: No such file"):
        session_files(tmp_path / "nowhere")


def test_a_card_with_invalid_numbers_is_not_a_reason_to_stop(short, container, altered):
    records = []
    for record in container.split(short.read_bytes()):
        if container.text("inteco_abs.result") in record.content:
            card = container.text('{"stop_time_s": NaN, "overruns": 1e999, "ticks": "many", "lost_ticks": 3}')
            content = container.text("card") + card
            name = container.text("inteco_abs.result")
            record = container.record(12, name + len(content).to_bytes(4, "little") + content)  # noqa: PLW2901
        records.append(record)
    path = altered(container.join(records)[:-100])
    row = session_row(path)
    assert (row["stop_time_s"], row["overruns"], row["lost_ticks"], row["ticks"]) == (None, None, 3, 60)
    assert len(read_session(path).ticks) == 60
