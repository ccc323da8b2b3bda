import pytest

from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.signals import BoardFlags, Phase, Reason, Sample

QUICK = (
    "guard.missed_in_a_row=4",
    "guard.bucket_limit=30",
    "experiment.start_speed_rad_s=80.0",
    "experiment.hold_s=0.05",
)


class Fault:
    """From `after` ticks inside `phase` on, change the samples; remembers when it began."""

    def __init__(self, phase: Phase, after: int, change) -> None:
        self.phase, self.after, self.change = phase, after, change
        self.seen = 0
        self.since = None

    def __call__(self, sample, phase):
        if self.since is None:
            self.seen += phase is self.phase
            if self.seen <= self.after:
                return sample
            self.since = sample
        return self.change(sample, self.since)


def frozen_road(sample, since):
    return sample._replace(road_count=since.road_count)


def frozen_wheel(sample, since):
    return sample._replace(wheel_count=since.wheel_count)


def swapped_road_sign(sample, _since):
    return sample._replace(road_count=-sample.road_count)


def reset_road(sample, since):
    return sample._replace(road_count=sample.road_count - since.road_count)


def failing(sample, since):
    return since._replace(tick=sample.tick, time_ns=sample.time_ns, dt_s=sample.dt_s, board_flags=BoardFlags.STALE)


def racing(sample, since):
    return sample._replace(wheel_count=since.wheel_count + 45 * (sample.tick - since.tick))


@pytest.mark.untraced
@pytest.mark.parametrize(
    ("phase", "after", "change", "reason", "within_s"),
    [
        (Phase.SPIN_UP, 0, frozen_road, Reason.ROAD_ENCODER_FROZEN, 0.352),
        (Phase.SPIN_UP, 2000, frozen_road, Reason.ROAD_ENCODER_FROZEN, 0.003),
        (Phase.BRAKING, 0, frozen_road, Reason.ROAD_ENCODER_FROZEN, 0.003),
        (Phase.BRAKING, 200, frozen_road, Reason.ROAD_ENCODER_FROZEN, 0.003),
        (Phase.SPIN_UP, 2000, frozen_wheel, Reason.ENCODERS_DISAGREE, 0.022),
        (Phase.SPIN_UP, 0, frozen_wheel, Reason.ENCODERS_DISAGREE, 2.0),
        (Phase.SPIN_UP, 0, swapped_road_sign, Reason.ROAD_BACKWARDS, 0.35),
        (Phase.SPIN_UP, 1000, reset_road, Reason.COUNT_JUMP, 0.001),
        (Phase.BRAKING, 100, reset_road, Reason.COUNT_JUMP, 0.001),
        (Phase.IDLE, 20, failing, Reason.MISSED_EXCHANGES, 0.002),
        (Phase.SPIN_UP, 1000, failing, Reason.MISSED_EXCHANGES, 0.002),
        (Phase.BRAKING, 100, failing, Reason.MISSED_EXCHANGES, 0.002),
        (Phase.SPIN_UP, 1000, racing, Reason.OVER_SPEED, 0.006),
        (Phase.BRAKING, 100, racing, Reason.ENCODERS_DISAGREE, 0.006),
    ],
)
def test_a_fault_takes_the_outputs_away_in_time_and_with_its_reason(experiment, phase, after, change, reason, within_s):
    fault = Fault(phase, after, change)
    moments = experiment(*QUICK).run(tamper=fault)
    last = moments[-1].tick
    assert (last.phase, last.reason) == (Phase.FAULT, reason)
    assert (last.drive, last.brake) == (0.0, 0.0)
    assert 0 <= (last.time_ns - fault.since.time_ns) * 1e-9 <= within_s


@pytest.mark.untraced
@pytest.mark.parametrize("after", [20, 150])
def test_wheel_encoder_frozen_while_braking_looks_locked_and_the_run_ends(experiment, after):
    moments = experiment(*QUICK).run(tamper=Fault(Phase.BRAKING, after, frozen_wheel))
    assert moments[-1].tick.phase is Phase.DONE
    assert all(moment.tick.drive == 0.0 for moment in moments if moment.tick.phase is Phase.BRAKING)


def test_a_drive_without_power_ends_in_a_frozen_road_within_350_ms():
    config = load_config(settings=QUICK)
    pipeline, encoder_rest = build_pipeline(config), (0, 0)
    driven = 0
    for tick in range(10_000):
        sample = Sample(tick, tick * config.period_ns, config.period_ns * 1e-9, *encoder_rest)
        driven += pipeline.step(sample).drive > 0.0
        if pipeline.finished:
            break
    assert pipeline.reason is Reason.ROAD_ENCODER_FROZEN
    assert 0.30 < driven * config.period_ns * 1e-9 < 0.352
