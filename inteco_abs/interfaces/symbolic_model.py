"""The braking model's equations as SymPy expressions, and their derivatives. Needs the extra `control`.

They hold while braking: a forward turning wheel that is slower at its rim than the road, so that s = s1 = s2 = 1 in
docs/facts/rig.md#model, a brake above its dead zone, and equation (8) for the adhesion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Final

from inteco_abs.errors import AbsError
from inteco_abs.rig import RigParameters

try:
    from sympy import Eq, Function, Matrix, Symbol, cos, lambdify, sin
except ImportError as error:
    raise AbsError("the model's equations need SymPy: pip install 'inteco-abs[control]'") from error

_LATEX: Final = {"phi_rad": "phi"}
SYMBOLS: Final[Mapping[str, Any]] = {
    field.name: Symbol(_LATEX.get(field.name, f"{field.name[0]}_{field.name[1:]}" if field.name[1:] else field.name))
    for field in fields(RigParameters)
}
"""Of the parameters, by their names in `RigParameters`."""
TIME: Final = Symbol("t")
WHEEL_SPEED, ROAD_SPEED = Symbol("x_1", positive=True), Symbol("x_2", positive=True)
TORQUE, DUTY = Symbol("M_1", positive=True), Symbol("u", positive=True)
SLIP, ADHESION, NORMAL_FORCE = Symbol("lambda", positive=True), Symbol("mu"), Symbol("F_n", positive=True)


@dataclass(frozen=True)
class SymbolicModel:
    """x' = rates(x, u) and slip(x); without lag the brake torque is not a state but follows the duty."""

    states: tuple[Any, ...]
    """Wheel speed and road speed in rad/s, and with lag the brake torque in N m."""
    rates: Any
    """Their derivatives, as a column in states and duty."""
    slip: Any
    slip_rate: Any
    """Derivative of the slip along `rates`, 1/s."""
    A: Any
    """Derivative of `rates` by the states."""
    B: Any
    """By the duty."""
    C: Any
    """Derivative of the slip by the states."""
    D: Any
    """By the duty: zero."""


def equations() -> dict[str, Any]:
    """The model as equations between its symbols, by their numbers in docs/facts/rig.md#model; `brake` is its lag."""
    k, mu, slip, Fn = SYMBOLS, ADHESION, SLIP, NORMAL_FORCE
    x1, x2, M1 = WHEEL_SPEED, ROAD_SPEED, TORQUE
    saturating = k["w4"] * slip ** k["p"] / (k["a"] + slip ** k["p"])
    lever = k["L"] * (sin(k["phi_rad"]) - mu * cos(k["phi_rad"]))
    rate = {state: Function(state.name)(TIME).diff(TIME) for state in (x1, x2, M1)}
    return {
        "(11)": Eq(slip, 1 - k["r1"] * x1 / (k["r2"] * x2)),
        "(8)": Eq(mu, saturating + k["w3"] * slip**3 + k["w2"] * slip**2 + k["w1"] * slip),
        "(5)": Eq(Fn, (k["Mg"] + M1 + k["M10"] + k["d1"] * x1) / lever),
        "(2)": Eq(rate[x1], (Fn * k["r1"] * mu - k["d1"] * x1 - k["M10"] - M1) / k["J1"]),
        "(3)": Eq(rate[x2], (-Fn * k["r2"] * mu - k["d2"] * x2 - k["M20"]) / k["J2"]),
        "brake": Eq(rate[M1], k["c31"] * (settled_torque() - M1)),
    }


def settled_torque() -> Any:
    """Torque that the brake settles to at the duty, N m."""
    return SYMBOLS["b1"] * DUTY + SYMBOLS["b2"]


@cache
def symbolic_model(*, lag: bool = True) -> SymbolicModel:
    """The model in states and duty; `lag=False` is for a brake that follows at once."""
    found = equations()
    inner = [(equation.lhs, equation.rhs) for equation in (found["(5)"], found["(8)"], found["(11)"])]
    rates = Matrix([found[number].rhs.subs(inner) for number in ("(2)", "(3)", "brake")])
    slip = found["(11)"].rhs
    states: tuple[Any, ...] = (WHEEL_SPEED, ROAD_SPEED, TORQUE)
    if not lag:
        rates, states = rates[:2, :].subs(TORQUE, settled_torque()), states[:2]
    column = Matrix(states)
    C = Matrix([slip]).jacobian(column)
    return SymbolicModel(
        states=states,
        rates=rates,
        slip=slip,
        slip_rate=(C * rates)[0],
        A=rates.jacobian(column),
        B=rates.diff(DUTY),
        C=C,
        D=Matrix([[0]]),
    )


@cache
def matrices(*, lag: bool = True) -> Callable[..., Any]:
    """Function of all parameters in their order, the states and the duty: numbers of A, B, C, D and of the rates."""
    model = symbolic_model(lag=lag)
    parts = [model.A, model.B, model.C, model.D, model.rates]
    found: Callable[..., Any] = lambdify([*SYMBOLS.values(), *model.states, DUTY], parts, modules="numpy", cse=True)
    return found
