"""The official TypeScript reader, which Lichtblick and Foxglove are built on, opens what we write."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from inteco_abs.format.io_frame import IO_NAME, IO_TOPIC, Direction
from inteco_abs.sessions import TICK, TRUTH, read_frames, read_session

LOCK = Path(__file__).with_name("package-lock.json")

NEW_NAMES = {"drive_wish": "drive_request", "brake_wish": "brake_request"}


def sums(rows):
    """Sums of every column in the order of the file, as that reader adds: 64 bits as text, without NaN."""
    found = {}
    for name in rows.dtype.names:
        values = rows[name]
        if values.dtype.kind == "f":
            numbers = values[~np.isnan(values)].astype(np.float64)
            found[name] = float(np.cumsum(numbers)[-1]) if len(numbers) else None
        else:
            total = sum(map(int, values.tolist()))
            found[name] = str(total) if values.dtype.itemsize == 8 else total
    return {name: value for name, value in found.items() if value is not None}


def not_numbers(rows):
    floats = [name for name in rows.dtype.names if rows[name].dtype.kind == "f"]
    return {name: int(np.isnan(rows[name]).sum()) for name in floats if np.isnan(rows[name]).any()}


def members(rows, message):
    """How often each member of an enumeration stands in a column."""
    found = {}
    for column in message.columns:
        if column.kind.members is not None and column.name in rows.dtype.names:
            prefix = column.kind.members.__name__.upper()
            numbers, counts = np.unique(rows[column.name], return_counts=True)
            names = [f"{prefix}_{column.kind.members(number).name}" for number in numbers.tolist()]
            found[column.name] = dict(zip(names, counts.tolist(), strict=True))
    return found


@pytest.fixture(scope="module")
def opened(path, in_typescript):
    """A session as we read it, and as they do."""
    return read_session(path), in_typescript(path)


@pytest.mark.untraced
def test_messages_are_as_many(opened):
    session, theirs = opened
    expected = {TICK.topic: len(session.ticks), "/abs/event": session.events, "/abs/params": 1}
    found = {topic: summary["messages"] for topic, summary in theirs["topics"].items()}
    assert found.pop(TRUTH.topic, 0) == len(session.truth)
    assert found.get(IO_TOPIC, 0) == session.frames
    assert {topic: found[topic] for topic in expected} == expected
    assert int(theirs["counted"]) == sum(summary["messages"] for summary in theirs["topics"].values())


def today(found):
    """What the other reader found, with the names that columns of older files have by now."""
    if isinstance(found, dict):
        return {NEW_NAMES.get(name, name): value for name, value in found.items()}
    return [NEW_NAMES.get(name, name) for name in found] if isinstance(found, list) else found


@pytest.mark.parametrize("message", [TICK, TRUTH], ids=["tick", "truth"])
def test_every_column_of_numbers_has_the_sum_that_numpy_finds(opened, message):
    session, theirs = opened
    rows = session.ticks if message is TICK else session.truth
    if message is TRUTH and not len(rows):
        assert message.topic not in theirs["topics"]  # a golden session keeps no truth
        return
    summary = {key: today(value) for key, value in theirs["topics"][message.topic].items()}
    rows = rows[[name for name in rows.dtype.names if name in summary["fields"]]]  # older files have fewer
    assert summary["schema"] == message.name
    assert summary["sums"] == sums(rows)
    assert summary["notNumbers"] == not_numbers(rows)
    assert summary["members"] == members(rows, message)


def test_the_raw_frames_are_of_the_same_directions_and_times(fresh, in_typescript):
    summary, capture = in_typescript(fresh)["topics"][IO_TOPIC], read_frames(fresh)
    counts = Counter(f"DIRECTION_{Direction[record.kind.name].name}" for record in capture.records)
    assert summary["schema"] == IO_NAME
    assert summary["members"] == {"direction": dict(counts)}
    times_ns = [capture.start_ns + round(record.t_s * 1e9) for record in capture.records]
    assert summary["sums"]["time_ns"] == str(sum(times_ns))


def test_log_metadata_and_attachments_are_there(opened):
    session, theirs = opened
    assert theirs["topics"]["/abs/event"]["lines"] == [event.text for event in session.log]
    assert {name.removeprefix("inteco_abs.") for name in theirs["metadata"]} == set(session.metadata)
    assert theirs["attachments"] == {name: len(data) for name, data in session.attachments.items()}


def test_the_packages_are_pinned_by_hash_and_not_by_place():
    packages = [package for place, package in json.loads(LOCK.read_text())["packages"].items() if place]
    assert all(package["integrity"].startswith("sha512-") for package in packages)
    assert not any("resolved" in package for package in packages)
