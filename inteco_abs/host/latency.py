"""Measures how punctual this computer is, and judges round trips with a board.

`python -m inteco_abs.host.latency SECONDS` is the child process of the wake-up test. It takes the loop's tuning, which
changes a process for good, and prints one JSON object.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Collection, Mapping, Sequence
from typing import Final, NamedTuple

from inteco_abs.host.checks import CheckResult, Judgement, amber, green, red
from inteco_abs.realtime import Clock, PacedClock, Quantiles, Setting, apply, loop_tuning, quantiles

SHORTEST_S, LONGEST_S = 0.2, 60.0
"""Limits of the duration of a wake-up test."""

_RATE_HZ: Final = 2000
_PERIOD_NS: Final = 1_000_000_000 // _RATE_HZ
_START_S: Final = 30.0
"""Longer than Python takes to start."""
_GOOD_P999_US: Final = 150.0
_GOOD_MISSED: Final = 0.0005
_BEARABLE_MISSED: Final = 0.01
_COMFORTABLE_SHARE: Final = 0.8
"""Share of a period for the board; the rest is for waking up and deciding."""
_QUIET: Final = "close other programs, follow the fixes above, and measure again with --seconds 60"


_NO_ENGINES: Final[Mapping[str, str]] = {}


class WakeUps(NamedTuple):
    """Result of the child process."""

    settings: list[Setting]
    late_us: Quantiles
    """Lateness of the beats, us."""
    beats: int
    missed: int
    """Periods without a beat."""


def wake_ups(clock: Clock, periods: int) -> tuple[list[int], int]:
    """Return the lateness of each beat, ns, and the number of missed periods, over about `periods` periods."""
    late: list[int] = []
    missed = 0
    now_ns = clock.now_ns
    for beat in clock:
        late.append(now_ns() - beat.deadline_ns)
        missed += beat.skipped
        if len(late) + missed >= periods:
            break
    return late, missed


def examine_wake_ups(seconds: float) -> list[CheckResult]:
    """Run the wake-up test for `seconds`: granted settings, and punctuality of the loop on this computer now."""
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
        CheckResult("loop settings", *judge_settings(seen.settings)),
        CheckResult("wake-ups", *judge_wake_ups(seen)),
    ]


def judge_settings(settings: Sequence[Setting]) -> Judgement:
    """Judge the loop's settings; without real-time priority nothing else helps."""
    refused = [setting for setting in settings if setting.refused]
    if not refused:
        return green("all granted: " + ", ".join(f"{name} {value}" for name, value, _ in settings))
    found = "refused: " + ", ".join(setting.name for setting in refused)
    fix = "\n".join(f"{setting.name}: {setting.refused}" for setting in refused)
    return red(found, fix) if any(setting.name == "scheduler" for setting in refused) else amber(found, fix)


def judge_wake_ups(seen: WakeUps) -> Judgement:
    """Judge by the figures for a stock kernel on a quiet computer (docs/facts/real-time.md#acceptance-figures)."""
    periods = seen.beats + seen.missed
    found = (
        f"late {seen.late_us}; {seen.missed} of {periods} periods missed"
        f" in one test of {periods / _RATE_HZ:g} s on this computer now"
    )
    missed = seen.missed / periods
    if missed < _GOOD_MISSED and seen.late_us.p999 < _GOOD_P999_US:
        return green(found)
    return amber(found, _QUIET) if missed <= _BEARABLE_MISSED else red(found, _QUIET)


def judge_round_trips(
    times_us: Collection[float], count: int, period_us: float, engines: Mapping[str, str] = _NO_ENGINES
) -> Judgement:
    """Judge the round trips of `count` exchanges against the period; `engines` are facts to add."""
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


def _not_tested(why: str) -> CheckResult:
    return CheckResult(
        "wake-ups", *red(f"the test did not finish: {why}", "run it again; if that does not help, report it")
    )


def _how_it_ended(code: int, stderr: str) -> str:
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    last = stderr.strip().splitlines()[-1:] or ["no message"]
    return f"exit code {code}, {last[0]}"


def _parse(text: str) -> WakeUps:
    result = json.loads(text)
    settings = [Setting(*setting) for setting in result["settings"]]
    return WakeUps(settings, Quantiles(*result["late_us"]), result["beats"], result["missed"])


def _main() -> None:
    seconds = float(sys.argv[1])
    settings = apply(loop_tuning())
    late_ns, missed = wake_ups(PacedClock(_PERIOD_NS), round(seconds * _RATE_HZ))
    late_us = quantiles([late / 1e3 for late in late_ns])
    print(json.dumps(WakeUps(settings, late_us, len(late_ns), missed)._asdict()))  # noqa: T201  to the parent


if __name__ == "__main__":
    _main()
