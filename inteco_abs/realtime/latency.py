"""How punctual this computer is now, and how quick a board: measured, not read off.

`python -m inteco_abs.realtime.latency SECONDS` is the child process of the wake-up test. It asks for everything that
the loop's process asks for, which changes a process for good, and prints one JSON object.
"""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Final, NamedTuple

from inteco_abs.boards import Board
from inteco_abs.errors import BoardError
from inteco_abs.realtime.clock import Clock, PacedClock
from inteco_abs.realtime.findings import Finding, Judgement, amber, green, red
from inteco_abs.realtime.machine import Setting, loop_wishes, prepare
from inteco_abs.signals import BoardFlags, Command

SHORTEST_S, LONGEST_S = 0.2, 60.0
"""Of a wake-up test."""

_RATE_HZ: Final = 2000
_PERIOD_NS: Final = 1_000_000_000 // _RATE_HZ
_START_S: Final = 30.0
"""More than Python ever takes to start."""
_GOOD_P999_US: Final = 150.0
_GOOD_MISSED: Final = 0.0005
_BEARABLE_MISSED: Final = 0.01
_COMFORTABLE_SHARE: Final = 0.8
"""Of a period, for the board; the rest is for waking up and deciding."""
_MOST_FAILURES_IN_A_ROW: Final = 20
"""As many as the guard of a real board at 2 kHz allows."""
_TURNS, _TURN_TRIALS = 5, 100
"""Of each engine; in turns, so that what comes and goes on the computer meets all of them."""
_WORTH_IT: Final = 0.9
"""Share of the usual engine's time that another must stay below to take its place."""
_RATE_TRIALS: Final = 1000
_RATE_MARGIN: Final = 1.2
_QUIET: Final = "close other programs, follow the fixes above, and measure again with --seconds 60"


_NO_ENGINES: Final[Mapping[str, str]] = {}


class Quantiles(NamedTuple):
    """Of a set of times, us; each is one of them."""

    p50: float
    p99: float
    p999: float
    max: float

    def __str__(self) -> str:
        return f"p50 {self.p50:.1f}, p99 {self.p99:.1f}, p99.9 {self.p999:.1f}, max {self.max:.1f} us"


class WakeUps(NamedTuple):
    """What the child process has seen."""

    settings: list[Setting]
    late_us: Quantiles
    """How long after their deadlines the beats came."""
    beats: int
    missed: int
    """Whole periods that passed without a beat."""


def quantiles(times_us: Collection[float]) -> Quantiles:
    """Nearest-rank quantiles of at least one time."""
    ordered = sorted(times_us)
    return Quantiles(*(ordered[-(-len(ordered) * permille // 1000) - 1] for permille in (500, 990, 999, 1000)))


def wake_ups(clock: Clock, periods: int) -> tuple[list[int], int]:
    """How late each beat came, ns, and how many periods were missed, over about so many periods."""
    late: list[int] = []
    missed = 0
    now_ns = clock.now_ns
    for beat in clock:
        late.append(now_ns() - beat.deadline_ns)
        missed += beat.skipped
        if len(late) + missed >= periods:
            break
    return late, missed


def examine_wake_ups(seconds: float) -> list[Finding]:
    """Run the wake-up test for so long: what the loop is granted here, and how punctual it would be.

    One short test tells how the computer is now. What comes once an hour is not in it.
    """
    command = [sys.executable, "-P", "-m", __name__, str(seconds)]
    try:
        child = subprocess.run(  # noqa: S603  this very module
            command, capture_output=True, text=True, timeout=seconds + _START_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return [_not_tested(str(error))]
    if child.returncode:
        return [_not_tested(_how_it_ended(child.returncode, child.stderr))]
    seen = _parse(child.stdout)
    return [
        Finding("loop settings", *judge_settings(seen.settings)),
        Finding("wake-ups", *judge_wake_ups(seen)),
    ]


def judge_settings(settings: Sequence[Setting]) -> Judgement:
    """Without the scheduler's first rank nothing else helps."""
    refused = [setting for setting in settings if setting.refused]
    if not refused:
        return green("all granted: " + ", ".join(f"{name} {value}" for name, value, _ in settings))
    found = "refused: " + ", ".join(setting.name for setting in refused)
    fix = "\n".join(f"{setting.name}: {setting.refused}" for setting in refused)
    return red(found, fix) if any(setting.name == "scheduler" for setting in refused) else amber(found, fix)


def judge_wake_ups(seen: WakeUps) -> Judgement:
    """By the acceptance figures for a stock kernel on a quiet computer (fact sheet on real time, section 12)."""
    periods = seen.beats + seen.missed
    found = (
        f"late {seen.late_us}; {seen.missed} of {periods} periods missed"
        f" in one test of {periods / _RATE_HZ:g} s on this computer now"
    )
    missed = seen.missed / periods
    if missed < _GOOD_MISSED and seen.late_us.p999 < _GOOD_P999_US:
        return green(found)
    return amber(found, _QUIET) if missed <= _BEARABLE_MISSED else red(found, _QUIET)


def round_trips(board: Board, count: int) -> list[float]:
    """Exchange SAFE `count` times in a row with an entered board: how long each took, us; failed ones are left out.

    Call it in a process that has what the loop has, else it tells more of the process than of the board. What follows
    on the board begins at tick 0. Raises BoardError once twenty exchanges in a row have failed.
    """
    board.hurried = False
    try:
        return _times_us(board, count)
    finally:
        board.hurried = True
        board.begin()


def _times_us(board: Board, count: int) -> list[float]:
    times_us: list[float] = []
    failed = 0
    for _ in range(count):
        start_ns = time.monotonic_ns()
        sample = board.exchange(Command.SAFE)
        end_ns = time.monotonic_ns()
        if not sample.board_flags & BoardFlags.STALE:
            times_us.append((end_ns - start_ns) / 1e3)
            failed = 0
            continue
        failed += 1
        if failed >= _MOST_FAILURES_IN_A_ROW:
            raise BoardError(f"the board does not answer: {board.last_error}") from board.last_error
    return times_us


def choose_engine(board: Board) -> dict[str, str]:
    """Time whole SAFE exchanges with each of the entered board's engines, and keep the one with the best 99 %.

    The usual one stays unless another is a tenth quicker. Facts for the user: the engine in use, and how long each
    one's exchanges took; nothing for a board that has none to choose from. Raises BoardError if it answers with none.
    """
    engines = board.engines
    if not engines:
        return {"engine": board.engine} if board.engine else {}
    times_us: dict[str, list[float]] = {engine: [] for engine in engines}
    failure = None
    for engine in engines * _TURNS:
        board.engine = engine
        try:
            tried = round_trips(board, _TURN_TRIALS)
        except BoardError as error:
            tried, failure = [], error
        times_us[engine] += tried + [math.inf] * (_TURN_TRIALS - len(tried))
    spreads = {engine: quantiles(times) for engine, times in times_us.items()}
    usual = engines[0]
    best = min(engines, key=lambda engine: spreads[engine].p99)
    if failure is not None and math.isinf(spreads[best].p50):
        raise failure
    board.engine = best if spreads[best].p99 < _WORTH_IT * spreads[usual].p99 else usual
    return {"engine": board.engine, **{f"exchanges, {engine}": str(spread) for engine, spread in spreads.items()}}


def insist_on_rate(board: Board, period_ns: int) -> dict[str, str]:
    """Raise BoardError, naming the rate that can be kept, if exchanges with an entered board take longer than a period.

    Chooses the engine first. Judged by the 99th percentile of a thousand, failed ones among them, with all outputs
    off: a run survives that one exchange in a hundred is lost or late, and says so. Facts for the session.
    """
    facts = choose_engine(board)
    times_us = round_trips(board, _RATE_TRIALS)
    failed = _RATE_TRIALS - len(times_us)
    spread = quantiles([*times_us, *[math.inf] * failed])
    period_us = period_ns * 1e-3
    facts["exchanges"] = f"{spread}; {failed} of {_RATE_TRIALS} failed"
    if spread.p99 <= period_us:
        return facts
    seen = "; ".join(f"{name}: {found}" for name, found in facts.items())
    if math.isinf(spread.p99):
        raise BoardError(f"{failed} of {_RATE_TRIALS} exchanges with the board failed: {board.last_error} ({seen})")
    rate_hz = math.floor(1e6 / (_RATE_MARGIN * spread.p99))
    raise BoardError(
        f"the board's exchanges take up to {spread.p99:.0f} us (99 % of {_RATE_TRIALS}), longer than the period of "
        f"{period_us:g} us. If this computer is busy, try again; else set loop.rate_hz to {rate_hz} or less, with "
        f"an estimator.window_s of at least one period. inteco-abs doctor --board tells more ({seen})"
    )


def judge_round_trips(
    times_us: Collection[float], count: int, period_us: float, engines: Mapping[str, str] = _NO_ENGINES
) -> Judgement:
    """Round trips of `count` exchanges against the period in which each has to fit; `engines` is what was tried."""
    if not times_us:
        return red(f"none of {count} exchanges succeeded", "check the cable and the board's power")
    spread, failed = quantiles(times_us), count - len(times_us)
    found = f"{spread}; {failed} of {count} exchanges failed; the period is {period_us:g} us"
    found += "".join(f"; {name}: {what}" for name, what in engines.items())
    late = sum(time_us >= period_us for time_us in times_us)
    if failed + late > _BEARABLE_MISSED * count:
        return red(found, "the board needs a longer period, or a better connection: no hub, a short cable")
    if failed or spread.p999 >= _COMFORTABLE_SHARE * period_us:
        return amber(found, "plug the board straight into the computer; close other programs")
    return green(found)


def _not_tested(why: str) -> Finding:
    return Finding(
        "wake-ups", *red(f"the test did not finish: {why}", "run it again; if that does not help, report it")
    )


def _how_it_ended(code: int, stderr: str) -> str:
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    last = stderr.strip().splitlines()[-1:] or ["no message"]
    return f"exit code {code}, {last[0]}"


def _parse(text: str) -> WakeUps:
    told = json.loads(text)
    settings = [Setting(*setting) for setting in told["settings"]]
    return WakeUps(settings, Quantiles(*told["late_us"]), told["beats"], told["missed"])


def _main() -> None:
    seconds = float(sys.argv[1])
    settings = prepare(loop_wishes())
    late_ns, missed = wake_ups(PacedClock(_PERIOD_NS), round(seconds * _RATE_HZ))
    late_us = quantiles([late / 1e3 for late in late_ns])
    print(json.dumps(WakeUps(settings, late_us, len(late_ns), missed)._asdict()))  # noqa: T201  to the parent


if __name__ == "__main__":
    _main()
