"""Step 6: low drive, then a rising brake duty: sense of rotation, and the brake's dead zone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from statistics import median
from typing import Final, NamedTuple

from inteco_abs.boards import family_of
from inteco_abs.commissioning.consent import agree_on_first_write
from inteco_abs.commissioning.operator import agree, wait_for
from inteco_abs.commissioning.outputs import PROVES_ITSELF, Outputs, WheelMotion, outputs, turns
from inteco_abs.commissioning.permission import DRIVE_LIMIT, outputs_permitted
from inteco_abs.commissioning.step import Facts, StepContext, today
from inteco_abs.config import RigConfig
from inteco_abs.errors import CommissioningError

PHRASE: Final = "the cover is closed, my hand is at the emergency switch"
_REQUEST: Final = (
    "The motors are about to turn, slowly: at most 20 % drive, then the brake up to its limit. A guardian process "
    "switches the outputs off if this program dies or hangs, but if the computer dies or the cable is pulled, only the "
    "emergency switch stops the motors.\nLower the balance lever, so that the wheels touch; close the "
    "cover; switch the power interface on; wait until both wheels are at rest."
)
_FIRST_DUTY, _DUTY_STEP = 0.05, 0.01
_NUDGE_S: Final = 0.3
"""Time at each drive duty, until a wheel moves."""
_MOVED_TURNS: Final = 0.05
_FOLLOW_S: Final = 0.5
"""More of the duty that moved the first wheel, for the other to follow."""
_RUN_UP_S: Final = 20.0
_SPEED_RAD_S: Final = 20.0
_ENOUGH_RAD_S: Final = 10.0
_SLOWEST_RAD_S: Final = 5.0
_SETTLE_S: Final = 0.2
_COAST_S: Final = 0.3
_BRAKE_STEP: Final = 0.02
_STEP_S: Final = 0.15
_SLOWS_DOWN: Final = 1.5
"""Ratio to the deceleration of coasting that counts as braking."""
_MOST_RUN_UPS: Final = 4
_VELOCITIES: Final = 5
"""Readings of the board's own velocity, whose step may be a tenth of the speed at a window of 5 ms."""
_MOST_OFF: Final = 0.25
_RESOLUTION_COUNTS: Final = 2.0
_MOST_STILL_COUNTS: Final = 8
_EXPECTED: Final = 0.415
"""End of the dead zone (vendor's manual, equation 6.1.11)."""
_ABOUT: Final = 0.1
KEYS: Final = ("drive_pwm", "brake_pwm", "pwm_mode", "pwm_prescaler")
PIN_KEYS: Final = ("pwm_pins", "pwm_functions")


class _Braked(NamedTuple):
    """Result of a brake ramp."""

    reached: float
    """Last tested duty."""
    onset: float | None
    """First duty that braked; None if the wheels were too slow before."""


def try_motors(context: StepContext) -> Facts:
    """Test emergency switch, drive and brake; every part ends with the outputs off."""
    config = outputs_permitted(context, _REQUEST, PHRASE)
    agreed = agree_on_first_write(context, config)
    wait_for(context.operator, "Press the emergency switch: it is tested first, and no wheel may move.")
    context.rig.powered(on=False)
    context.operator.say(f"  {PROVES_ITSELF}")
    with outputs(context, config) as out:
        _require_rest(out)
        if _nudge(out, config) is not None:
            raise CommissioningError(
                "a wheel moved although the emergency switch is pressed: do not use this rig until it cuts the drive"
            )
    context.operator.say("  nothing moved: the emergency switch cuts the drive")
    wait_for(context.operator, "Turn the switch to release it, press ON, and put your hand on the switch again.")
    context.rig.powered(on=True)
    context.operator.say("  driving, then braking; at most a minute and a half")
    with outputs(context, config) as out:
        _require_rest(out)
        moving_duty = _drive(out, config)  # no output here: a halted terminal would keep the drive on
        onset, coast_rad_s2 = _find_dead_zone(out, config)
        lines = _counts_per_turn(out, config)
    _compare_counts(context, config, lines)
    context.operator.say(f"  both wheels turn forwards from {moving_duty:.0%} drive")
    context.operator.say(
        f"  the brake acts from a duty of {onset:.2f}{_compared(onset)}; coasting loses {coast_rad_s2:.1f} rad/s2"
    )
    context.draft.confirm(_confirmed(config), f"drove and braked on {today()}")
    found = {**agreed, "moving_duty": moving_duty, "brake_from": onset, "coast_rad_s2": coast_rad_s2}
    return found if lines is None else {**found, "counts_per_turn_by_velocity": lines}


def _require_rest(out: Outputs) -> None:
    for motion in out.hold(0.0, 0.0, _COAST_S):
        if max(abs(motion.wheel_counts), abs(motion.road_counts)) > _MOST_STILL_COUNTS:
            raise CommissioningError("a wheel moves although both outputs are off: wait until both are at rest")


def _nudge(out: Outputs, config: RigConfig) -> tuple[float, WheelMotion] | None:
    """Raise the drive in small steps until a wheel moves; return duty and motion, or None if none moves."""
    duty = _FIRST_DUTY
    while duty <= DRIVE_LIMIT + 1e-9:
        for motion in out.hold(duty, 0.0, _NUDGE_S):
            if max(abs(turns(motion.wheel_counts, config)), abs(turns(motion.road_counts, config))) > _MOVED_TURNS:
                return duty, motion
        duty += _DUTY_STEP
    return None


def _drive(out: Outputs, config: RigConfig) -> float:
    """Duty from which both wheels turn forwards. Raises CommissioningError with what to check."""
    nudged = _nudge(out, config)
    if nudged is None:
        raise CommissioningError(
            f"no wheel moved at up to {DRIVE_LIMIT:.0%} drive: is the power interface on, the emergency switch "
            f"released, and the drive really on PWM {config.board.drive_pwm}? If not, --set board.drive_pwm=N"
        )
    duty, motion = nudged
    for motion in out.hold(duty, 0.0, _FOLLOW_S):
        _require_sense(motion, config)
    for name, counts in (("lower", motion.road_counts), ("upper", motion.wheel_counts)):
        if turns(counts, config) < _MOVED_TURNS / 2:
            raise CommissioningError(
                f"the {name} wheel does not turn with the other: lower the balance lever; if both do turn, their "
                "encoders are not the ones that you turned by hand: --redo wheels"
            )
    return duty


def _require_sense(motion: WheelMotion, config: RigConfig) -> None:
    for name, key, counts in (("lower", "road_sign", motion.road_counts), ("upper", "wheel_sign", motion.wheel_counts)):
        if turns(counts, config) < -_MOVED_TURNS / 2:
            raise CommissioningError(
                f"the {name} wheel counts backwards when driven: board.{key}, the sign found by hand, is wrong: run "
                "`commission --redo wheels` and turn this wheel the way the drive turns it"
            )


def _find_dead_zone(out: Outputs, config: RigConfig) -> tuple[float, float]:
    """Duty from which the brake acts, and the deceleration of coasting, rad/s2."""
    duty = 0.0
    for _ in range(_MOST_RUN_UPS):
        _run_up(out)
        coast = _coast(out)
        braked = _ramp(out, config, duty, coast)
        if braked.onset is not None:
            return braked.onset, coast
        duty = max(0.0, braked.reached - 2 * _BRAKE_STEP)  # the last steps may have been too slow to show it
    raise CommissioningError(
        "the wheels stop too soon to try all of the brake: is it stuck? Turn the upper wheel by hand"
    )


def _run_up(out: Outputs) -> None:
    motion = out.beat(DRIVE_LIMIT, 0.0)
    for motion in out.hold(DRIVE_LIMIT, 0.0, _RUN_UP_S):
        if motion.road_speed_rad_s >= _SPEED_RAD_S:
            return
    if motion.road_speed_rad_s < _ENOUGH_RAD_S:
        raise CommissioningError(
            f"{DRIVE_LIMIT:.0%} drive reach {motion.road_speed_rad_s:.1f} rad/s within {_RUN_UP_S:g} s, too slow to "
            "try the brake: does something rub?"
        )


def _coast(out: Outputs) -> float:
    """Deceleration without drive and brake, rad/s2."""
    *_, begin = out.hold(0.0, 0.0, _SETTLE_S)
    *_, end = out.hold(0.0, 0.0, _COAST_S)
    return (begin.wheel_speed_rad_s - end.wheel_speed_rad_s) / (end.time_s - begin.time_s)


def _counts_per_turn(out: Outputs, config: RigConfig) -> int | None:
    """Counts per turn by the board's velocity register while the wheels coast; None without one, or if too slow.

    The register counts lines of the encoder's disc in a time by the board's clock, and the vendor's conversion takes
    1024 lines for a turn. So it shows whether the counter multiplies them by two or four, not how many lines there are.
    """
    velocity = family_of(config.board.kind).velocity
    if not velocity:
        return None
    _run_up(out)
    out.beat(0.0, 0.0)
    ratios = []
    for _ in range(_VELOCITIES):
        rpm, motion = out.measured(velocity), out.beat(0.0, 0.0)
        if rpm and motion.road_speed_rad_s >= _SLOWEST_RAD_S:
            ratios.append(motion.road_speed_rad_s / (rpm * 2.0 * math.pi / 60.0))
    return round(median(ratios) * config.encoders.counts_per_turn) if len(ratios) == _VELOCITIES else None


def _compare_counts(context: StepContext, config: RigConfig, by_velocity: int | None) -> None:
    """Ask the operator if velocity register and turns by hand disagree. Raises CommissioningError if not certain."""
    by_hand = config.encoders.counts_per_turn
    if by_velocity is None or abs(by_velocity - by_hand) <= _MOST_OFF * by_hand:
        return
    context.operator.say(
        f"  the board's velocity register makes {by_velocity} counts per turn, if the encoder's disc has 1024 lines as "
        f"the vendor's has; turning by hand gave {by_hand}"
    )
    if not agree(context.operator, f"Did you turn each wheel exactly as often as asked, so that {by_hand} is right?"):
        raise CommissioningError("the counts per turn are not certain: --redo wheels")


def _ramp(out: Outputs, config: RigConfig, first: float, coast_rad_s2: float) -> _Braked:
    """Raise the brake until the upper wheel slows down faster than by coasting, in two steps in a row.

    Raises CommissioningError at the brake limit.
    """
    least_rad_s = 2.0 * math.pi * turns(1, config) * _RESOLUTION_COUNTS / _STEP_S
    slowed = 0
    before = out.beat(0.0, first)
    duty = first
    for duty in _duties(first, config.guard.brake_limit):
        *_, now = out.hold(0.0, duty, _STEP_S)
        lost = before.wheel_speed_rad_s - now.wheel_speed_rad_s
        usual = coast_rad_s2 * (now.time_s - before.time_s)
        slowed = slowed + 1 if lost > _SLOWS_DOWN * usual + least_rad_s else 0
        if slowed == 2:
            return _Braked(duty, round(duty - _BRAKE_STEP, 3))
        if now.wheel_speed_rad_s < _SLOWEST_RAD_S:
            return _Braked(duty, None)
        before = now
    raise CommissioningError(
        f"the brake did nothing up to {duty:.2f}: check its supply, its cable, and that it is on PWM "
        f"{config.board.brake_pwm}. If not, --set board.brake_pwm=N"
    )


def _duties(first: float, limit: float) -> Iterator[float]:
    steps = round((limit - first) / _BRAKE_STEP + 0.499)
    return (min(first + step * _BRAKE_STEP, limit) for step in range(1, steps + 1))


def _compared(onset: float) -> str:
    if abs(onset - _EXPECTED) <= _ABOUT:
        return f", about as the vendor's manual says ({_EXPECTED})"
    return f", while the vendor's manual says {_EXPECTED}: the controller's model does not fit this brake"


def _confirmed(config: RigConfig) -> tuple[str, ...]:
    board = config.board
    pins = [key for key in PIN_KEYS if key not in family_of(board.kind).unused_wiring]
    return (*KEYS, *pins, *(("timer",) if board.timer >= 0 else ()))  # every exchange has compared it with our clock
