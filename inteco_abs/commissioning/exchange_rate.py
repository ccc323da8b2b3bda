"""Step 3: how fast the board answers, and which rate that allows."""

from __future__ import annotations

from typing import Final

from inteco_abs.commissioning.reading import open_for_reading, require_same_board
from inteco_abs.commissioning.step import Facts, StepContext
from inteco_abs.errors import CommissioningError, LinkError
from inteco_abs.realtime import RATE_MARGIN, Histogram, quantiles

READS: Final = 1000
_MOST_FAILED: Final = 10
MORE_THAN_A_READ: Final = 1.5
"""A tick has three transfers, a reading two; the exact time is measured when a run begins."""
_WINDOW_PERIODS: Final = 5
"""Shorter windows give mostly noise as speed."""
_RATES_HZ: Final = (10_000.0, 5000.0, 2000.0, 1000.0, 500.0, 250.0, 200.0, 100.0, 50.0)


def measure_reads(context: StepContext) -> Facts:
    """Time 1000 readings; write the loop rate that they allow into the draft.

    Raises CommissioningError if more than 10 readings fail, or if they are too slow for any rate.
    """
    config = context.draft.config
    names = [f"encoder{i}_count" for i in (config.board.road_encoder, config.board.wheel_encoder)]
    times_us: list[float] = []
    failed = 0
    with open_for_reading(context) as board:
        require_same_board(board, config)
        for _ in range(READS):
            start_ns = context.rig.now_ns()
            try:
                board.survey(names)
            except LinkError as error:
                failed += 1
                if failed > _MOST_FAILED:
                    raise CommissioningError(
                        f"{failed} of {len(times_us) + failed} readings failed: {error}"
                    ) from error
            else:
                times_us.append((context.rig.now_ns() - start_ns) * 1e-3)
    spread = quantiles(times_us)
    if not spread.max:
        context.operator.say(f"  {READS} readings, {failed} failed; in virtual time they take none, so the rate stays")
        return {"reads": READS, "failed": failed}
    rate_hz = kept_rate(config.loop.rate_hz, spread.p999)
    mean_hz = 1e6 * len(times_us) / sum(times_us)
    context.operator.say(
        f"  {READS} readings, {failed} failed: {spread}, {mean_hz:.0f} per second\n"
        f"  loop.rate_hz = {rate_hz:g} can be kept; a run measures whole exchanges before it begins"
    )
    window_s = max(config.estimator.window_s, _WINDOW_PERIODS / rate_hz)
    context.draft.write({"loop.rate_hz": rate_hz, "estimator.window_s": window_s})
    histogram = Histogram()
    histogram.add(times_us)
    times = {"times_us": spread._asdict(), "histogram_us": histogram.sparse()}
    return {"reads": READS, "failed": failed, "per_second": mean_hz, **times, "rate_hz": rate_hz}


def kept_rate(wanted_hz: float, read_us: float) -> float:
    """`wanted_hz`, or else the highest usual rate below it that exchanges keep if a reading takes `read_us`.

    Raises CommissioningError if none fits.
    """
    possible_hz = 1e6 / (RATE_MARGIN * MORE_THAN_A_READ * read_us)
    if wanted_hz <= possible_hz:
        return wanted_hz
    for rate_hz in _RATES_HZ:
        if rate_hz <= min(possible_hz, wanted_hz):
            return rate_hz
    raise CommissioningError(
        f"a reading takes up to {read_us:.0f} us (99.9 %): too slow for any rate; no hub, a short cable"
    )
