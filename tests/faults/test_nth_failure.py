"""The k-th request to the operating system is refused, for every k: once, always, or with all that follow."""

import time
from collections import Counter

import pytest

from inteco_abs.sessions import environment, provenance, read_session
from tests.faults.operations import Refusal
from tests.faults.refusals import LASTS, SCENES, prepared_place, problems, refuse

pytestmark = pytest.mark.untraced


@pytest.fixture(scope="module")
def place():
    with prepared_place() as where:
        yield where


@pytest.mark.parametrize(("step", "ways"), [(4, 1), pytest.param(1, len(LASTS), marks=pytest.mark.long)])
@pytest.mark.parametrize("scene", SCENES)
def test_a_refusal_leaves_outputs_off_and_loses_no_tick_unreported(place, record_property, scene, step, ways):
    """Every request in all of the ways, or one in four, which the commit draws, in one of them, by turns."""
    kinds, runs, bad = refuse(place, scene, ways, step)
    record_counts(record_property, scene, kinds, runs, bad)
    assert not bad, "\n".join(bad)


def record_counts(record_property, scene: str, kinds: Counter[str], runs: int, bad: list[str]) -> None:
    counted = ", ".join(f"{number} {kind}" for kind, number in sorted(kinds.items()))
    record_property("figures", f"{scene}: {counted}; {runs} runs with requests refused, violations: {len(bad)}")


def test_a_git_that_cannot_be_started_keeps_no_run_from_its_end(place, record_property, monkeypatch):
    monkeypatch.setattr(provenance, "_git", GIT)
    monkeypatch.setattr(environment, "installed_packages", lambda: b"")
    cached = environment.current_environment
    cached.cache_clear()
    kinds = place.perform("a stop").requests.kinds
    starts = [number for number, kind in enumerate(kinds) if kind == "process"]
    bad = []
    for refusal in (Refusal(number, lasts) for number in starts for lasts in ("once", "kind")):
        cached.cache_clear()
        run = place.perform("a stop", refusal)
        bad += [f"{refusal}: {problem}" for problem in problems(place, run)]
        bad += [f"{refusal}: {run.error!r}"] if run.error else []
    cached.cache_clear()
    record_counts(record_property, "git", Counter(process=len(starts)), 2 * len(starts), bad)
    assert starts
    assert not bad, "\n".join(bad)


GIT = provenance._git
HOUR_NS = 3_600 * 10**9
CLOCKS = {
    "an hour back": lambda now_ns: now_ns - HOUR_NS,
    "a day on": lambda now_ns: now_ns + 24 * HOUR_NS,
    "never set": lambda _: 0,
}


@pytest.mark.parametrize("wrong", CLOCKS)
def test_a_clock_that_is_wrong_from_the_kth_look_on_costs_no_tick(place, record_property, monkeypatch, wrong):
    """The computer's date; a run's own time is the board's or the monotonic clock's."""
    time_ns, looks = time.time_ns, Looks()

    def look():
        return (CLOCKS[wrong] if looks.wrong else int)(time_ns())

    monkeypatch.setattr(time, "time_ns", look)
    place.perform("a stop")
    most, bad = looks.number, []
    for k in range(most):
        for for_good in (False, True):
            looks.begin(k, for_good=for_good)
            run = place.perform("a stop")
            assert looks.number > k
            session = read_session(place.session)
            if run.error or any(run.devices[0].duties) or session.incomplete or session.payload != place.whole:
                bad.append(f"look {k}, for good: {for_good}: {run.error!r}")
    record_property("figures", f"a clock {wrong}: {most} looks, {2 * most} runs, violations: {len(bad)}")
    assert most
    assert not bad, "\n".join(bad)


class Looks:
    """Looks at a clock, of which the k-th is wrong, or all from the k-th on."""

    def __init__(self) -> None:
        self.begin(-1, for_good=False)

    def begin(self, k: int, *, for_good: bool) -> None:
        self.number, self._k, self._for_good = 0, k, for_good

    @property
    def wrong(self) -> bool:
        number, self.number = self.number, self.number + 1
        return 0 <= self._k <= number if self._for_good else number == self._k
