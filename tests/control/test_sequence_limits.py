"""When the sequence steps on, to the last count and nanosecond."""

import math

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import PhaseMachine
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Reason, Sample

SETTINGS = ("experiment.idle_s=0.5", "experiment.hold_s=0.5", "experiment.braking_timeout_s=0.5")
BLIND = Estimate(math.nan, math.nan, 0.0, valid=False)
COUNT_RAD_S = 2.0 * math.pi / 2048 * 1e9
"""Speed of one count in a nanosecond."""


class Even:
    def update(self, _estimate, _dt_s):
        return BrakeDemand(0.5)


class Timed:
    """A sequence that begins in a phase, at a time, and sees a road that moves by so many counts."""

    def __init__(self, phase: Phase = Phase.IDLE, *settings: str, start_ns: int = 0) -> None:
        self.sequence = PhaseMachine(load_config(settings=[*SETTINGS, *settings]), Even(), phase)
        self.time_ns, self.road = start_ns, 0
        self.see(0)

    def see(self, after_ns: int, counts: int = 0):
        self.time_ns += after_ns
        self.road += counts
        self.sequence.advance(Sample(0, self.time_ns, 0.0005, 0, self.road), BLIND)
        return self.sequence

    @property
    def phase(self) -> Phase:
        return self.sequence.phase


@pytest.mark.parametrize("start_ns", [0, 1, 7_000_000_000])
@pytest.mark.parametrize(("after_ns", "phase"), [(499_999_999, Phase.IDLE), (500_000_000, Phase.ARMED)])
def test_idle_ends_when_its_time_is_over_whenever_the_clock_began(start_ns, after_ns, phase):
    timed = Timed(start_ns=start_ns)
    timed.see(after_ns)
    assert timed.phase is phase


@pytest.mark.parametrize(("after_ns", "phase"), [(19_999_999, Phase.SPIN_UP), (20_000_000, Phase.BRAKING)])
def test_a_run_up_takes_20_ms_at_least(after_ns, phase):
    timed = Timed(Phase.SPIN_UP)
    timed.see(after_ns, 2000)
    assert timed.phase is phase


@pytest.mark.parametrize(("more", "phase"), [(0.0, Phase.BRAKING), (1e-9, Phase.SPIN_UP)])
def test_the_start_speed_itself_is_reached(more, phase):
    timed = Timed(Phase.SPIN_UP, f"experiment.start_speed_rad_s={1000 * COUNT_RAD_S / 25_000_000 + more!r}")
    timed.see(25_000_000, 1000)
    assert timed.phase is phase


@pytest.mark.parametrize(
    ("after_ns", "reason"), [(1_000_000_000, Reason.NONE), (1_000_000_001, Reason.SPIN_UP_TIMEOUT)]
)
def test_a_run_up_may_take_all_of_its_time(after_ns, reason):
    assert Timed(Phase.SPIN_UP, "experiment.spin_up_timeout_s=1.0").see(after_ns).reason is reason


@pytest.mark.parametrize(("after_ns", "reason"), [(500_000_000, Reason.NONE), (500_000_001, Reason.BRAKING_TIMEOUT)])
def test_a_stop_may_take_all_of_its_time(after_ns, reason):
    assert Timed(Phase.BRAKING).see(after_ns, 1000).reason is reason


@pytest.mark.parametrize(("after_ns", "phase"), [(49_999_999, Phase.BRAKING), (50_000_000, Phase.STOPPED)])
def test_a_stop_takes_50_ms_at_least(after_ns, phase):
    timed = Timed(Phase.BRAKING)
    timed.see(after_ns)
    assert timed.phase is phase


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("more", "phase"), [(0.0, Phase.BRAKING), (1e-9, Phase.STOPPED)])
def test_the_stop_speed_itself_is_not_rest(sign, more, phase):
    timed = Timed(Phase.BRAKING, f"experiment.stop_speed_rad_s={10 * COUNT_RAD_S / 60_000_000 + more!r}")
    timed.see(60_000_000, sign * 10)
    assert timed.phase is phase


@pytest.mark.parametrize(("after_ns", "phase"), [(499_999_999, Phase.STOPPED), (500_000_000, Phase.DONE)])
def test_the_brake_is_released_when_the_hold_time_is_over(after_ns, phase):
    timed = Timed(Phase.BRAKING)
    timed.see(60_000_000)
    assert timed.phase is Phase.STOPPED
    timed.see(after_ns)
    assert timed.phase is phase


def test_nothing_is_demanded_of_the_brake_but_while_braking_and_at_rest():
    timed, demands = Timed(), {}
    for _ in range(5000):
        machine = timed.see(10_000_000, 1000 if timed.phase is Phase.SPIN_UP else 0)
        command = Command(machine.drive_request, machine.brake_request)
        demands.setdefault(timed.phase, set()).add((machine.demand, command))
    nothing = (BrakeDemand(0.0), Command.SAFE)
    assert demands[Phase.IDLE] == demands[Phase.ARMED] == demands[Phase.DONE] == {nothing}
    assert demands[Phase.SPIN_UP] == {nothing, (BrakeDemand(0.0), Command(1.0, 0.0))}
    assert demands[Phase.BRAKING] == {nothing, (BrakeDemand(0.5), Command(0.0, 0.5))}
    assert demands[Phase.STOPPED] == {(BrakeDemand(0.5), Command(0.0, 0.5))}
