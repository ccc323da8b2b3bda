import random

import pytest

from inteco_abs.signals import BoardFlags, Phase, Reason

pytestmark = pytest.mark.untraced

STRICT = ("guard.missed_in_a_row=4", "guard.bucket_limit=30")
CASES = {
    "2048 counts": ("encoders.counts_per_turn=2048",),
    "4096 counts": ("encoders.counts_per_turn=4096",),
    "vendor's brake limit": ("guard.brake_limit=0.7",),
    "large gains": ("controller.gains={Mk=10.0, Mq=4.0}",),
    "literal euler": ("estimator.name=euler",),
    "relay": ("controller.name=relay", "controller.reference_slip=0.7"),
    "wheel locked from the start": ("controller.name=relay", "controller.gains={off_duty=1.0}"),
    "half drive": ("experiment.drive_duty=0.5", "experiment.start_speed_rad_s=100.0"),
    "500 Hz": ("loop.rate_hz=500.0",),
    "250 Hz": ("loop.rate_hz=250.0",),
    "100 Hz": ("loop.rate_hz=100.0",),
}


def outcome(moments) -> tuple[Phase, Reason]:
    last = moments[-1].tick
    return last.phase, last.reason


SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))]
SOME = ("4096 counts", "vendor's brake limit", "literal euler", "wheel locked from the start", "100 Hz")


@pytest.mark.parametrize(
    "settings", [pytest.param(CASES[name], id=name, marks=() if name in SOME else pytest.mark.long) for name in CASES]
)
def test_no_false_trip_from_spin_up_to_standstill(experiment, settings):
    moments = experiment(*STRICT, *settings).run()
    assert outcome(moments) == (Phase.DONE, Reason.NONE)
    assert {moment.tick.reason for moment in moments} == {Reason.NONE}
    assert moments[-1].road_speed < 0.5


def test_the_locked_case_does_lock_the_wheel_while_the_road_is_fast(experiment):
    moments = experiment(*STRICT, *CASES["wheel locked from the start"]).run()
    assert any(moment.wheel_speed == 0.0 and moment.road_speed > 100.0 for moment in moments)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_false_trip_with_ticks_that_are_late_and_now_and_then_skipped(experiment, seed):
    rng = random.Random(seed)
    misses = 0

    def periods(tick: int) -> float:
        nonlocal misses
        skipped = rng.choice([1, 2, 3]) if tick % 25 == 24 else 0
        misses += skipped
        return 1.0 + skipped + rng.uniform(-0.4, 0.4)

    moments = experiment(*STRICT, "experiment.start_speed_rad_s=100.0").run(periods=periods)
    assert outcome(moments) == (Phase.DONE, Reason.NONE)
    assert misses > 300


@pytest.mark.parametrize("seed", SEEDS)
def test_no_false_trip_with_exchanges_that_fail_now_and_then(experiment, seed):
    rng = random.Random(seed)
    counts, failed = (0, 0), 0

    def tamper(sample, _phase):
        nonlocal counts, failed
        if sample.tick % 20 < 3 and rng.random() < 0.5:
            failed += 1
            return sample._replace(wheel_count=counts[0], road_count=counts[1], board_flags=BoardFlags.STALE)
        counts = sample.wheel_count, sample.road_count
        return sample

    moments = experiment(*STRICT, "experiment.start_speed_rad_s=180.0").run(tamper=tamper)
    assert outcome(moments) == (Phase.DONE, Reason.NONE)
    assert failed > 500


@pytest.mark.parametrize("rate_hz", [2000.0, 500.0, 250.0, 100.0])
def test_no_false_trip_with_answers_that_are_late_by_up_to_a_period(experiment, rate_hz):
    """A board reads its counts before it answers, and the time stamp is that of the arrival."""
    rng = random.Random(round(rate_hz))
    before_ns, late = None, 0

    def tamper(sample, _phase):
        nonlocal before_ns, late
        now_ns = sample.time_ns
        if rng.random() < 0.03:
            now_ns += round(rng.uniform(0.5, 0.95) * 1e9 / rate_hz)
            late += 1
        dt_s = sample.dt_s if before_ns is None else (now_ns - before_ns) / 1e9
        before_ns = now_ns
        return sample._replace(time_ns=now_ns, dt_s=dt_s)

    moments = experiment(*STRICT, f"loop.rate_hz={rate_hz}", "estimator.window_s=0.04").run(tamper=tamper)
    assert outcome(moments) == (Phase.DONE, Reason.NONE)
    assert late > 10
