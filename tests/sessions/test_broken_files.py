"""A session that was cut or changed anywhere is refused, or read, validated, recovered and replayed without a lie."""

import random
import struct
import zlib
from bisect import bisect_right

import numpy as np
import pytest

from inteco_abs.errors import SessionError
from inteco_abs.sessions import read_frames, read_session, recover_session, validate
from tests.sessions.breaking import Trial, flip

pytestmark = pytest.mark.untraced  # the same code runs traced elsewhere, and these are many runs

CHUNK, MESSAGE_INDEX, METADATA, DATA_END = 6, 7, 12, 15


@pytest.fixture
def trial(short, tmp_path):
    return Trial(short, tmp_path)


def test_the_file_itself_is_well_and_nothing_of_it_is_lost(short, tmp_path):
    assert validate(short).findings == []
    recovery = recover_session(short, tmp_path / "recovered.mcap")
    assert (recovery.losses, recovery.missing) == ((), ())
    assert read_session(tmp_path / "recovered.mcap").payload == read_session(short).payload


def power_lost_at(ends, trial, container) -> None:
    """Every tick of every chunk that is all there, no other, and word that there may have been more."""
    records = container.split(trial.data)
    whole_chunks = [record.end for record in records if record.opcode == CHUNK]
    (data_end,) = (record.end for record in records if record.opcode == DATA_END)
    for end in ends:
        trial.of(trial.data[:end], end)
    assert trial.lies == []
    # the first chunk has what explains the session, the last one the result, each of the others ten ticks
    assert trial.recovered == [10 * max(0, bisect_right(whole_chunks[:-1], end) - 1) for end in ends]
    assert trial.lossless == [end for end in ends if end >= data_end]


@pytest.mark.long
def test_power_lost_between_any_two_records_or_in_the_head_of_one(trial, container):
    records = container.split(trial.data)
    between = [at for record in records for at in (record.at, record.end)]
    around = [
        end + off for record in records if record.opcode == CHUNK for end in (record.at, record.end) for off in (-1, 1)
    ]
    heads = [record.at + 1 + number % 8 for number, record in enumerate(records)]
    power_lost_at(sorted({*between, *around, *heads} - {len(trial.data)}), trial, container)


@pytest.mark.parametrize("times", [60, pytest.param(500, marks=pytest.mark.long)])
def test_power_lost_anywhere(trial, container, times):
    chance = random.Random(times)
    first = next(record.end for record in container.split(trial.data) if record.opcode == CHUNK)
    ends = [chance.randrange(*where) for where in ((0, first), (first, len(trial.data))) for _ in range(times // 2)]
    power_lost_at(ends, trial, container)
    assert len(set(trial.recovered)) == 7


@pytest.mark.parametrize("chunk", [2, *(pytest.param(chunk, marks=pytest.mark.long) for chunk in (3, 4, 5)), 6])
def test_the_verbs_end_with_3_after_a_loss_of_power(short, container, altered, verb, tmp_path, chunk):
    data = short.read_bytes()
    ends = [record.end for record in container.split(data) if record.opcode == CHUNK]
    for cut in (ends[chunk] - 1, ends[chunk], ends[chunk] + 1):
        path, ticks = altered(data[:cut]), 10 * (chunk - (cut < ends[chunk]))
        assert [verb(name, path).code for name in ("info", "validate", "replay")] == [3, 3, 3]
        again = tmp_path / f"{cut}.mcap"
        done = verb("recover", path, "-o", again, "--json")
        assert (done.code, done.json["ticks"]) == (3, ticks)
        payload = read_session(again).payload
        assert read_session(short).payload[: len(payload)] == payload
        assert verb("info", path, "--json").json["ticks"] == ticks


@pytest.fixture(params=["complete", "cut"])
def with_a_wrong_length(request, short, container, altered):
    """The session, complete or cut in its seventh chunk, with one bit of a record's length flipped.

    The record is the last one of its type before the fifth chunk ends, or that chunk.
    """
    data = short.read_bytes()
    records = container.split(data)
    chunks = [record for record in records if record.opcode == CHUNK]
    if request.param == "cut":
        data = data[: chunks[6].end - 1]

    def flipped(opcode, bit):
        at = [record.at for record in records if record.opcode == opcode and record.at <= chunks[4].at][-1]
        changed = bytearray(data)
        changed[at + 1 + bit // 8] ^= 1 << bit % 8
        return altered(bytes(changed))

    return flipped


@pytest.mark.parametrize(("opcode", "lost"), [(CHUNK, 10), (MESSAGE_INDEX, 0), (METADATA, 0)])
def test_flipped_bit_of_a_length_is_damage_and_other_chunks_are_recovered(
    with_a_wrong_length, tmp_path, request, opcode, lost
):
    ticks = 50 if request.node.callspec.params["with_a_wrong_length"] == "cut" else 60
    for bit in range(64):
        path = with_a_wrong_length(opcode, bit)
        for read in (read_session, read_frames):
            with pytest.raises(SessionError, match=r"is damaged: .*; inteco-abs recover saves "):
                read(path)
        if bit % 7 == 0:
            recover_session(path, tmp_path / f"{bit}.mcap")
            assert len(read_session(tmp_path / f"{bit}.mcap").ticks) == ticks - lost


def test_the_verbs_refuse_a_wrong_length_and_name_recover(with_a_wrong_length, verb, tmp_path, request):
    path = with_a_wrong_length(CHUNK, 40)
    verbs = [("info",), ("replay",), ("export", "-o", tmp_path / "x.npz"), ("what-if", "--set", "Mk=5")]
    if request.node.callspec.params["with_a_wrong_length"] == "complete":  # info reads the index alone
        assert verb(*verbs.pop(0), path).code == 0
    for name, *more in verbs:
        done = verb(name, path, *more)
        assert (done.code, done.out) == (1, "")
        words = " ".join(done.err.split())
        assert "but intact records follow from byte" in words
        assert "inteco-abs recover saves the intact ticks" in words


HOSTILE = [struct.pack("<d", value) for value in (np.nan, np.inf, -np.inf, 1.4e306, -1e300, 5e-324, -0.0)]
HOSTILE += [struct.pack("<Q", value) for value in (0, 1, 1 << 31, 1 << 32, 1 << 63, (1 << 64) - 1)]


def with_other_ticks(container, data, generator):
    """A session that was cut, with other bytes in some ticks: every checksum right, and no hash that shows it."""
    records = [r for r in container.split(data) if b"inteco_abs.integrity" not in r.content]
    records = records[: next(at for at, record in enumerate(records) if record.opcode == DATA_END)]
    at = generator.choice([at for at, record in enumerate(records) if record.opcode == CHUNK])
    raw = bytearray(container.unpack(records[at]))
    for _ in range(generator.choice((1, 1, 2, 10))):
        place = generator.randrange(len(raw) - 8)
        fresh = generator.choice((generator.randbytes(1), generator.randbytes(8), *HOSTILE))
        raw[place : place + len(fresh)] = fresh
    records[at] = container.chunk(bytes(raw), len(raw), "", zlib.crc32(raw))
    return container.magic + b"".join(map(bytes, records))


def change_ticks(trial, container, seed, times) -> None:
    generator = random.Random(seed)
    for number in range(times):
        trial.of_ticks(with_other_ticks(container, trial.data, generator), (seed, number))


def test_ticks_changed_under_right_checksums_are_refused_or_replayed(trial, container):
    change_ticks(trial, container, seed=7, times=25)
    assert trial.lies == []


@pytest.mark.long
def test_ticks_changed_under_right_checksums_and_often(trial, container):
    change_ticks(trial, container, seed=8, times=3_000)
    assert trial.lies == []


def test_changed_anywhere(trial):
    flip(trial, seed=2, times=30)
    assert trial.lies == []
    assert np.median(trial.recovered) >= 50


@pytest.mark.long
def test_changed_anywhere_and_often(trial):
    flip(trial, seed=3, times=3_000)
    assert trial.lies == []


def test_cut_and_changed(trial):
    generator = random.Random(4)
    for number in range(50):
        data = bytearray(trial.data[: generator.randrange(1000, len(trial.data))])
        data[generator.randrange(len(data))] ^= generator.randrange(1, 256)
        trial.of(bytes(data), number)
    assert trial.lies == []


def test_bytes_that_are_missing_or_doubled(trial):
    generator = random.Random(5)
    for number in range(50):
        first, second = sorted(generator.sample(range(len(trial.data)), 2))
        gone = trial.data[:first] + trial.data[second:]
        doubled = trial.data[:second] + trial.data[first:]
        trial.of(generator.choice((gone, doubled)), number)
    assert trial.lies == []


@pytest.mark.parametrize("name", ["info", "validate", "recover", "replay"])
def test_every_verb_reports_an_error_in_a_few_lines(short, altered, verb, tmp_path, name):
    generator = random.Random(6)
    data = short.read_bytes()
    for number in range(15):
        changed = bytearray(data[: generator.choice((len(data), generator.randrange(len(data))))])
        if changed:
            changed[generator.randrange(len(changed))] ^= generator.randrange(1, 256)
        out = ["-o", tmp_path / f"{number}.mcap"] if name == "recover" else []
        done = verb(name, altered(bytes(changed)), *out)
        # 4 where the byte is one of a gain's, which stands in the metadata and in the configuration
        assert done.code in {0, 1, 3} | ({4} if name == "replay" else set()), done
        assert "Traceback" not in done.err
        assert "internal error" not in done.err
        assert done.code == 0 or len((done.out + done.err).splitlines()) in range(
            1, 100
        )  # all that there is, of a cut one
