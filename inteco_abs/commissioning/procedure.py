"""The steps of the commissioning in order, and their results."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Any, Final

from inteco_abs.commissioning.encoders import KEYS, turn_wheels
from inteco_abs.commissioning.exchange_rate import measure_reads
from inteco_abs.commissioning.identity import list_boards, read_header
from inteco_abs.commissioning.motors import try_motors
from inteco_abs.commissioning.operator import wait_for
from inteco_abs.commissioning.pwm_echo import echo_settings
from inteco_abs.commissioning.sign_off import sign
from inteco_abs.commissioning.step import Step, StepContext
from inteco_abs.config import WIRING
from inteco_abs.errors import AbsError, AnswerError, ConfigError, Stopped, near_match

DONE: Final = "done"
_FAILED: Final = "failed"
_LOGIC: Final = ("logic_version", "application_names")
_PWM: Final = (
    "drive_pwm", "brake_pwm", "pwm_mode", "pwm_prescaler", "pwm_pins", "pwm_functions", "numbering_pwm", "frame_map",
    "constants", "timer",
)  # fmt: skip

STEPS: Final = (
    Step(
        "list",
        "lists devices that may be the board, as the kernel knows them",
        "none: no board is opened",
        "plug the board in and switch it on; inteco-abs doctor checks permissions",
        list_boards,
    ),
    Step(
        "header",
        "identifies the board; puts logic_version and application_names into the profile",
        "none: one READ request",
        "one program at a time; check cable and permissions; name the board's kind in --board",
        read_header,
        _LOGIC,
    ),
    Step(
        "reads",
        "reads a thousand times for rate and jitter; puts loop.rate_hz into the profile",
        "none: READ requests",
        "plug the board straight into the computer; close other programs",
        measure_reads,
        _LOGIC,
    ),
    Step(
        "wheels",
        "watches the encoders while you turn each wheel by hand; puts encoders, signs and counts into the profile",
        "none from the board: READ requests; your hands are at the wheels, so the power interface is off",
        "check the encoders' cable; turn one wheel at a time, with the lever lifted",
        turn_wheels,
        (*_LOGIC, *KEYS),
    ),
    Step(
        "echo",
        "shows word by word what the first write would change, and asks; then writes PWM settings with the power "
        "interface OFF, and checks that they come back",
        "low: outputs are written, nothing is connected to power",
        "the profile's PWM words may not be this logic's: capture what the vendor's software writes",
        echo_settings,
        (*_LOGIC, *_PWM),
    ),
    Step(
        "motors",
        "drives slowly, then brakes in small steps; confirms channels and signs, finds the brake's dead zone",
        "HIGH: motors turn. Cover closed, one hand at the emergency switch",
        "outputs are off; look for what the message names, then --redo motors",
        try_motors,
        (*_LOGIC, *KEYS, *_PWM),
    ),
    Step(
        "sign",
        "asks who has verified all this; writes verified_by, verified_on, verified_logic and the limits of the guard",
        "none now: the profile may be used for runs from here on",
        "the draft stays unsigned and opens the board for reading only",
        sign,
        (*_LOGIC, *WIRING),
    ),
)
_ASK_AGAIN: Final = "the same command asks again; type what stands between the quotes, or press just Enter"
_QUIET: Final = ("list", "header", "reads")
"""Steps that need no operator."""


class Procedure:
    """Does the steps in order, over as many calls of the command as needed."""

    def __init__(self, context: StepContext) -> None:
        self._context = context
        self._draft = context.draft

    def go(self, only: str = "", redo: str = "") -> None:
        """Do the remaining steps; or `only` this step; or `redo` this step and then the remaining ones.

        A quiet context ends before the first step that needs an operator. Raises ConfigError for a step that does not
        exist or comes after one that is not done, AbsError if a step fails, Stopped if the operator stops.
        """
        for step in self._wanted(only, redo):
            self._do(step)

    def state(self) -> list[dict[str, Any]]:
        """Each step with its number, outcome and results."""
        return [
            {"step": number, "name": step.name, **self._draft.results.get(step.name, {}), "outcome": self.outcome(step)}
            for number, step in enumerate(STEPS, 1)
        ]

    def outcome(self, step: Step) -> str:
        """`done`, `failed`, `outdated` (the draft's wiring has changed since), or `open`."""
        result = self._draft.results.get(step.name)
        if result is None:
            return "open"
        outcome = str(result["outcome"])
        signed = step.name != STEPS[-1].name or bool(self._draft.config.board.verified_by)
        same = signed and result.get("rests_on") == self._draft.wiring(step.rests_on)
        return outcome if outcome != DONE or same else "outdated"

    @property
    def next(self) -> str:
        """Name of the first step that is not done; empty when all are."""
        return next((step.name for step in STEPS if self.outcome(step) != DONE), "")

    def _wanted(self, only: str, redo: str) -> Iterator[Step]:
        """Steps to do, decided after each step, as one may outdate later ones."""
        if only or redo:
            step = find_step(only or redo)
            self._require_earlier(step)
            yield step
        if only:
            return
        while name := self.next:
            if self._context.quiet and name not in _QUIET:
                return
            yield find_step(name)

    def _require_earlier(self, step: Step) -> None:
        for earlier in STEPS[: STEPS.index(step)]:
            if self.outcome(earlier) != DONE:
                problem = f"{step.name} comes after {earlier.name}, which is {self.outcome(earlier)}"
                raise ConfigError.of("--step", problem)

    def _do(self, step: Step) -> None:
        operator = self._context.operator
        number = STEPS.index(step) + 1
        operator.say(f"\nStep {number} of {len(STEPS)}, {step.name}: {step.does}.\n  Risk: {step.risk}.")
        try:
            if not self._context.quiet:
                wait_for(operator, "Begin?")
            facts = step.run(self._context)
        except Stopped:
            raise
        except AbsError as error:
            advice = _ASK_AGAIN if isinstance(error, AnswerError) else step.if_it_fails
            error.add_note(f"step {number} ({step.name}) failed. What to do: {advice}")
            self._draft.record(step.name, {"outcome": _FAILED, "on": _now(), "problem": str(error)})
            raise
        rests_on = self._draft.wiring(step.rests_on)
        self._draft.record(step.name, {"outcome": DONE, "on": _now(), "rests_on": rests_on, **facts})


def find_step(name: str) -> Step:
    """The step of that name or number; raises ConfigError."""
    for number, step in enumerate(STEPS, 1):
        if name in (step.name, str(number)):
            return step
    names = [step.name for step in STEPS]
    raise ConfigError.of("--step", f"no step {name!r}, 1..{len(STEPS)}{near_match(name, names)}")


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
