"""A session that was cut or changed anywhere is refused, or read, validated, recovered and replayed without a lie."""

import random
from collections.abc import Iterator

import numpy as np
import pytest

from inteco_abs.control import CONTROLLERS, build_pipeline, control_check
from inteco_abs.errors import AbsError
from inteco_abs.sessions import before_the_gap, read_session, recover_session, replay, session_config, validate

pytestmark = pytest.mark.untraced  # the same code runs traced elsewhere, and these are many runs

CHUNK = 6


class Trial:
    """Breaks one file again and again, and remembers what was said of it that is not so."""

    def __init__(self, path, tmp_path) -> None:
        self.data, self.whole = path.read_bytes(), read_session(path)
        self.ticks = {int(row["tick"]): row.tobytes() for row in self.whole.ticks}
        self.broken, self.out = tmp_path / "broken.mcap", tmp_path / "recovered.mcap"
        self.lies = []
        self.recovered = []
        """Ticks that each recovery gave."""

    def of(self, data, what) -> None:
        self.broken.write_bytes(data)
        for check in (self._reads, self._validates, self._recovers):
            try:
                wrong = list(check())
            except AbsError:
                continue
            except Exception as error:  # noqa: BLE001  which variant made it fail says more than the traceback
                wrong = [repr(error)]
            if wrong:
                self.lies.append((what, check.__name__, wrong))

    def _reads(self) -> Iterator[str]:
        session = read_session(self.broken)
        if not self.whole.payload.startswith(session.payload):
            yield "a tick that was not recorded"
        yield from self._replays(session)

    def _replays(self, session) -> Iterator[str]:
        config = session_config(session, (control_check(CONTROLLERS),))
        if replay(before_the_gap(session), build_pipeline(config, CONTROLLERS)).differing:
            yield "a replay that differs"

    def _validates(self) -> Iterator[str]:
        if validate(self.broken).verdict == "well":
            yield "all is well"

    def _recovers(self) -> Iterator[str]:
        self.out.unlink(missing_ok=True)
        self.recovered.append(0)
        recovery = recover_session(self.broken, self.out)
        session = read_session(self.out)
        self.recovered[-1] = len(session.ticks)
        numbers = session.ticks["tick"].tolist()
        if session.incomplete or session.metadata["session"]["outcome"] != "recovered":
            yield "no whole session"
        if [self.ticks.get(number) for number in numbers] != [row.tobytes() for row in session.ticks]:
            yield "a tick that was not recorded"
        missing = {number for first, last in recovery.missing for number in range(first, last + 1)}
        if missing & set(numbers) or missing | set(numbers) < set(range(max(numbers))):
            yield f"missing are {sorted(missing)}"
        if not recovery.losses and session.payload != self.whole.payload:
            yield "nothing was lost"
        if len(self.recovered) % 4 == 0:
            if validate(self.out).verdict != ("losses" if recovery.losses else "well"):
                yield f"what was recovered is {validate(self.out).findings}"
            yield from self._replays(session)


@pytest.fixture
def trial(short, tmp_path):
    return Trial(short, tmp_path)


def test_the_file_itself_is_well_and_nothing_of_it_is_lost(short, tmp_path):
    assert validate(short).findings == []
    recovery = recover_session(short, tmp_path / "recovered.mcap")
    assert (recovery.losses, recovery.missing) == ((), ())
    assert read_session(tmp_path / "recovered.mcap").payload == read_session(short).payload


def test_cut_between_any_two_records(trial, container):
    records = container.split(trial.data)
    ends = sorted({at for record in records for at in (record.at, record.end)} - {len(trial.data)})
    for end in ends:
        trial.of(trial.data[:end], end)
    assert trial.lies == []
    assert max(trial.recovered) == len(trial.whole.ticks)


def test_cut_anywhere(trial):
    for end in random.Random(1).sample(range(len(trial.data)), 200):
        trial.of(trial.data[:end], end)
    assert trial.lies == []
    assert len(set(trial.recovered)) >= 6


def flip(trial, seed, times) -> None:
    """Another value for one byte, for two, or for a stretch of them."""
    generator = random.Random(seed)
    for number in range(times):
        data = bytearray(trial.data)
        for _ in range(generator.choice((1, 1, 1, 2))):
            at = generator.randrange(len(data))
            length = generator.choice((1, 1, 1, 50))
            fresh = generator.randbytes(length)
            data[at : at + length] = bytes(a ^ (b or 1) for a, b in zip(data[at : at + length], fresh, strict=False))
        trial.of(bytes(data), (seed, number))


def test_changed_anywhere(trial):
    flip(trial, seed=2, times=500)
    assert trial.lies == []
    assert np.median(trial.recovered) >= 50


@pytest.mark.long
def test_changed_anywhere_and_often(trial):
    flip(trial, seed=3, times=10_000)
    assert trial.lies == []


def test_cut_and_changed(trial):
    generator = random.Random(4)
    for number in range(50):
        data = bytearray(trial.data[: generator.randrange(1000, len(trial.data))])
        data[generator.randrange(len(data))] ^= generator.randrange(1, 256)
        trial.of(bytes(data), number)
    assert trial.lies == []


def test_a_stretch_that_is_gone_or_doubled(trial):
    generator = random.Random(5)
    for number in range(50):
        first, second = sorted(generator.sample(range(len(trial.data)), 2))
        gone = trial.data[:first] + trial.data[second:]
        doubled = trial.data[:second] + trial.data[first:]
        trial.of(generator.choice((gone, doubled)), number)
    assert trial.lies == []


@pytest.mark.parametrize("name", ["info", "validate", "recover", "replay"])
def test_a_verb_says_what_is_wrong_in_a_few_lines(short, altered, verb, tmp_path, name):
    generator = random.Random(6)
    data = short.read_bytes()
    for number in range(15):
        changed = bytearray(data[: generator.choice((len(data), generator.randrange(len(data))))])
        if changed:
            changed[generator.randrange(len(changed))] ^= generator.randrange(1, 256)
        out = ["-o", tmp_path / f"{number}.mcap"] if name == "recover" else []
        done = verb(name, altered(bytes(changed)), *out)
        assert done.code in {0, 1, 3}, done
        assert "Traceback" not in done.err
        assert "internal error" not in done.err
        assert done.code == 0 or len((done.out + done.err).splitlines()) in range(1, 60)
