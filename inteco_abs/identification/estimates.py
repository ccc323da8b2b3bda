"""Result of an identification: each parameter with its interval, and the section [model.identified]."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np
import tomli_w

from inteco_abs.config import ModelConfig
from inteco_abs.errors import AbsError, ConfigError, describe_disk
from inteco_abs.identification.discs import HARMONICS, amplitude
from inteco_abs.identification.fit import Fit, Progress, fit
from inteco_abs.identification.parameters import ASSUMED, Priors, torque_name
from inteco_abs.identification.segments import Segment, SegmentKind
from inteco_abs.rig import AdhesionCurve, DriveMotor, RigParameters, adhesion, measured_torque, nominal_parameters
from inteco_abs.sessions import check_output
from inteco_abs.views.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

SLIPS: Final = (0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Slips at which the friction curve is reported."""
_SHARE: Final = 0.95
_SAMPLES: Final = 20_000
"""Draws from which the width of an interval is known to 1 %."""
_LEARNED: Final = 0.5
"""Largest standard deviation of an identified parameter, as a share of the prior's."""
_STEP: Final = 1e-5
_LEAST_SLOPE_NM: Final = 1e-4
_WORKING_SHARE: Final = 0.25
"""Share of the largest torque above which the points of the brake map are fitted by a straight line."""
_NEEDED: Final[Mapping[str, tuple[SegmentKind, str]]] = {
    "d": ("coast-down", "a coast-down"),
    "M0": ("coast-down", "a coast-down"),
    "drive_stall_torque": ("run-up", "a run-up"),
    "drive_no_load_speed": ("run-up", "a run-up"),
    "brake_lag": ("braking", "brake steps"),
    "brake_dead_time": ("braking", "brake steps"),
    "brake_release_ratio": ("braking", "brake steps and a release"),
    "brake_release_delay": ("braking", "brake steps and a release"),
    "brake_fade": ("braking", "brake steps"),
    "r1/r2": ("run-up", "a run-up"),
}

_DISC_ERRORS: Final = dict(zip(HARMONICS, ("eccentricity", "second_harmonic"), strict=True))
_MOST_DISC_COUNTS: Final = 100.0
"""Without a measurement; the limit of `EncoderVariation`."""
_OF_THE_BRAKE: Final = {
    "brake_dead_time": ("brake_dead_time_s", 0.0, 0.2),
    "brake_release_ratio": ("brake_release_ratio", 0.3, 4.0),
    "brake_release_delay": ("brake_release_delay_s", -0.2, 0.2),
    "brake_fade": ("brake_fade_per_kj", 0.0, 5.0),
}
"""Key of [model.identified] of an estimate, with its range there."""

EstimateStatus = Literal["identified", "assumed", "not identified"]


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter of the rig with its interval of 95 %."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    published: float
    status: EstimateStatus
    why: str = ""
    """Why it is not identified; empty for other parameters."""

    def facts(self) -> dict[str, Any]:
        """Return the estimate for JSON."""
        facts = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return facts | {"published": None if math.isnan(self.published) else self.published}


def check_parameter_file(path: Path) -> None:
    """Check that parameters can be written to the new file `path`. Raises ConfigError or SessionError."""
    if path.suffix != ".toml":
        raise ConfigError.of("--out", f"{path}: must end in .toml")
    check_output(path)


class _Derived(NamedTuple):
    """A quantity that follows from the fit parameters."""

    name: str
    unit: str
    of: Callable[[Mapping[str, float]], float]
    published: float


@dataclass(frozen=True, slots=True, repr=False)
class Identification(Shown):
    """The identified parameters of a rig."""

    fit: Fit
    segments: tuple[Segment, ...]
    estimates: tuple[ParameterEstimate, ...]
    model: ModelConfig
    """The model that gave the priors and the geometry."""

    @property
    def missing(self) -> list[ParameterEstimate]:
        """Parameters that are not identified."""
        return [each for each in self.estimates if each.status == "not identified"]

    def save(self, path: str | Path, sections: Mapping[str, Any] | None = None) -> Path:
        """Write the parameters to the new file `path` (.toml), for `run --config` or connect(config=...).

        `sections` are further ones of the file, as {"controller": {"name": "boundary-layer"}}. Raises ConfigError,
        SessionError or AbsError.
        """
        out = Path(path)
        check_parameter_file(out)
        try:
            out.write_text(
                tomli_w.dumps({"model": self.identified_model.as_table(), **(sections or {})}),
                encoding="utf-8",
                newline="\n",
            )
        except OSError as error:
            raise AbsError(f"{out}: the parameters cannot be written: {describe_disk(error)}") from error
        return out

    def plot(self) -> Figure:
        """Measured minus simulated counts, a panel for each segment. Raises AbsError without matplotlib."""
        from inteco_abs.identification.figure import figure_of_residuals  # noqa: PLC0415  an extra

        return figure_of_residuals(self.traces())

    def __rich__(self) -> RenderableType:
        from inteco_abs.identification.table import render_identification  # noqa: PLC0415  for a screen alone

        return render_identification(self.report())

    def __repr__(self) -> str:
        found = sum(each.status == "identified" for each in self.estimates)
        state = "" if self.fit.converged else ", did not converge: look at the residuals"
        return f"<Identification: {found} of {len(self.estimates)} parameters from {len(self.segments)} phases{state}>"

    def report(self) -> dict[str, Any]:
        """Return all estimates for JSON and tables."""
        return {
            "schema_version": 1,
            "converged": self.fit.converged,
            "assumed_within": dict(self.fit.priors.assumed),
            "estimates": [each.facts() for each in self.estimates],
            "residuals": [
                {
                    "session": channel.segment.session,
                    "segment": channel.segment.kind,
                    "wheel": channel.wheel,
                    "rms_counts": float(np.sqrt(np.mean(residual * residual))),
                    "samples": len(residual),
                }
                for channel, residual in self.fit.residuals
            ],
            "discs": [
                {
                    "session": channel.segment.session,
                    "segment": channel.segment.kind,
                    "wheel": channel.wheel,
                    "cosines_and_sines_counts": error.coefficients.tolist(),
                }
                for channel, error in self.fit.discs
            ],
        }

    def traces(self) -> list[dict[str, Any]]:
        """Residuals for a figure: measured minus simulated counts, by segment and wheel."""
        return [
            {
                "segment": f"{channel.segment.session}, {channel.segment.kind}",
                "wheel": channel.wheel,
                "time_s": channel.segment.time_s[channel.segment.compared],
                "residual_counts": residual,
            }
            for channel, residual in self.fit.residuals
        ]

    def to_toml(self) -> str:
        """The section [model], as TOML."""
        return tomli_w.dumps({"model": self.identified_model.as_table()})

    @property
    def identified_model(self) -> ModelConfig:
        """The model with the identified parameters; the others keep their values, as does the geometry."""
        by_name = {each.name: each for each in self.estimates}
        parameters = self.fit.priors.parameters(self.fit.values())

        def known(*names: str) -> bool:
            return all(by_name[name].status != "not identified" for name in names if name in by_name)

        own: dict[str, Any] = {name: getattr(parameters, name) for name in ("J1", "J2", "Mg", "d1", "M10")}
        if known("r1/r2"):
            own["r1"] = parameters.r1
        if known("d", "M0"):
            own |= {"d2": parameters.d2, "M20": parameters.M20}
        if known(*(_mu_name(slip) for slip in SLIPS)):
            own |= {name: getattr(parameters, name) for name in ("w1", "w2", "w3", "w4", "a", "p")}
        if known("brake_lag"):
            own["c31"] = parameters.c31
        for name, (key, low, high) in _OF_THE_BRAKE.items():
            if known(name):
                own[key] = min(max(low, by_name[name].value), high)
        if known("drive_stall_torque", "drive_no_load_speed"):
            own["drive_stall_torque_nm"] = by_name["drive_stall_torque"].value
            own["drive_no_load_speed_rad_s"] = by_name["drive_no_load_speed"].value
        own |= _brake_map(
            [
                (level, by_name[torque_name(level)].value)
                for level in self.fit.priors.levels
                if known(torque_name(level))
            ],
            self.fit.priors.base,
        )
        return replace(self.model, identified=replace(self.model.identified, **own))

    def uncertainty(self, reference_slip: float) -> list[str] | None:
        """The intervals as statements for `design`, for a law that holds `reference_slip`; None if one is missing.

        As the law's brake is a straight line, the largest distance of the working points from it is that of b2.
        """
        by_name = {each.name: each for each in self.estimates}
        line = self.identified_model.identified
        points = [
            (level, by_name[torque_name(level)])
            for level in self.fit.priors.levels
            if by_name[torque_name(level)].status == "identified"
        ]
        needed = [by_name[name] for name in ("r1/r2", "d2", "M20", *map(_mu_name, SLIPS))]
        if line.b1 is None or line.b2 is None or any(each.status == "not identified" for each in needed):
            return None
        highest = max(torque.value for _, torque in points)
        working = [(duty, torque) for duty, torque in points if torque.value >= _WORKING_SHARE * highest]
        mu = np.interp(reference_slip, SLIPS, [_share(by_name[_mu_name(slip)]) for slip in SLIPS])
        off = {name: _half(by_name[name]) for name in ("J1", "J2", "Mg", "d1", "M10", "d2", "M20")}
        off["r1"] = _half(by_name["r1/r2"]) * self.fit.priors.base.r2
        off["mu"] = float(mu)
        off["brake_gain"] = max(_share(torque) for _, torque in working)
        off["b2"] = max(abs(line.b1 * duty + line.b2 - torque.value) for duty, torque in working)
        return [f"{name}={value:.3g}" for name, value in off.items()]


def _half(estimate: ParameterEstimate) -> float:
    return 0.5 * (estimate.high - estimate.low)


def _share(estimate: ParameterEstimate) -> float:
    """Half of the interval as a share of the value."""
    return _half(estimate) / abs(estimate.value)


def identify(
    segments: Sequence[Segment],
    model: ModelConfig,
    assumed: Mapping[str, float] = ASSUMED,
    progress: Progress | None = None,
) -> Identification:
    """Identify the rig of `segments`.

    The parameters of `model` are the priors, and its geometry is that of the rig; `assumed` is the uncertainty of what
    is assumed, as shares.
    """
    base = nominal_parameters(model)
    levels = tuple(sorted({level for segment in segments for level in segment.levels}))
    found = fit(segments, Priors(base, levels, {**ASSUMED, **assumed}), progress)
    kinds = {segment.kind for segment in segments}
    return Identification(found, tuple(segments), (*_estimates(found, kinds), *_disc_errors(found)), model)


def _disc_errors(found: Fit) -> Iterator[ParameterEstimate]:
    """Amplitude of each harmonic of both discs."""
    for wheel in ("wheel", "road"):
        errors = [error for channel, error in found.discs if channel.wheel == wheel]
        for harmonic, kind in _DISC_ERRORS.items():
            name, why = f"{wheel}_{kind}", "no phase has enough turns of it"
            if errors:
                yield ParameterEstimate(name, "counts", *amplitude(errors, harmonic), 0.0, "identified")
            else:
                yield ParameterEstimate(name, "counts", *(0.0, 0.0, _MOST_DISC_COUNTS), 0.0, "not identified", why)


def _estimates(found: Fit, kinds: set[SegmentKind]) -> Iterator[ParameterEstimate]:
    priors, assumed = found.priors, {"J1", "J2", "Mg", "d1", "M10"}
    for derived in _all_derived(priors):
        slope = _slope(derived, found)
        off, sd = half_width(slope, found), math.sqrt(slope @ found.total @ slope)
        before = math.sqrt(slope @ found.before @ slope)
        value = derived.of(found.values())
        kind, what = _NEEDED.get(derived.name, ("braking", "brake steps that reach it"))
        why = "" if kind in kinds or derived.name in assumed else f"no session has {what}"
        if not why and derived.name not in assumed and sd > _LEARNED * before:
            why = "the sessions do not separate it from the rest"
        status: EstimateStatus = "assumed" if derived.name in assumed else "not identified" if why else "identified"
        yield ParameterEstimate(
            derived.name, derived.unit, value, value - off, value + off, derived.published, status, why
        )


def half_width(slope: Any, found: Fit) -> float:
    """Half of the interval: an error of the fit, which is normal, and those of what is assumed, evenly distributed."""
    fixed = found.moved.shape[1]
    shares = slope @ found.moved @ np.linalg.inv(found.priors.weights[:fixed, :fixed])
    rng = np.random.default_rng(0)
    assumed = shares @ rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), (fixed, _SAMPLES))
    own = math.sqrt(slope @ found.covariance @ slope) * rng.standard_normal(_SAMPLES)
    return float(np.quantile(np.abs(assumed + own), _SHARE))


def derived_slopes(found: Fit) -> dict[tuple[str, str], Any]:
    """Slopes of all quantities that follow from the parameters, by name and unit."""
    return {(derived.name, derived.unit): _slope(derived, found) for derived in _all_derived(found.priors)}


def _slope(derived: _Derived, found: Fit) -> Any:
    """Slope by each fit parameter."""
    rows = np.repeat(found.found[None, :], 2 * len(found.found), axis=0)
    count = len(found.found)
    rows[np.arange(count), np.arange(count)] += _STEP
    rows[np.arange(count) + count, np.arange(count)] -= _STEP
    values = np.array([derived.of(found.priors.values(row)) for row in rows.tolist()])
    return (values[:count] - values[count:]) / (2.0 * _STEP)


def _all_derived(priors: Priors) -> Iterator[_Derived]:
    base, share = priors.base, priors.rolling_share
    ratio, motor = base.r2 / base.r1, DriveMotor()
    published_d, published_M0 = base.d2 + share * base.d1, base.M20 + ratio * base.M10
    inertia = base.J2 + share * base.J1
    for name, unit in (("J1", "kg m2"), ("J2", "kg m2"), ("Mg", "N m"), ("d1", "N m s"), ("M10", "N m")):
        yield _Derived(name, unit, _constant(priors, name), getattr(base, name))
    yield _Derived("d", "N m s", lambda v: v["scale"] * v["d"], published_d)
    yield _Derived("M0", "N m", lambda v: v["scale"] * v["M0"], published_M0)
    yield _Derived("d/J", "1/s", lambda v: v["d"] / inertia, published_d / inertia)
    yield _Derived("M0/J", "rad/s2", lambda v: v["M0"] / inertia, published_M0 / inertia)
    yield _Derived("d2", "N m s", _constant(priors, "d2"), base.d2)
    yield _Derived("M20", "N m", _constant(priors, "M20"), base.M20)
    yield _Derived("drive_stall_torque", "N m", lambda v: v["scale"] * v["stall"], motor.stall_torque_nm)
    yield _Derived("drive_no_load_speed", "rad/s", lambda v: v["no_load"], motor.no_load_speed_rad_s)
    yield _Derived("brake_lag", "s", lambda v: v["lag"], 1.0 / base.c31)
    yield _Derived("brake_dead_time", "s", lambda v: v["dead_time"], math.nan)
    yield _Derived("brake_release_ratio", "1", lambda v: v["release"], 1.0)
    yield _Derived("brake_release_delay", "s", lambda v: v["release_delay"], 0.0)
    yield _Derived("brake_fade", "1/kJ", lambda v: v["fade"] / v["scale"], 0.0)
    yield _Derived("r1/r2", "1", lambda v: v["r1/r2"], base.r1 / base.r2)
    for level in priors.levels:
        yield _Derived(torque_name(level), "N m", _torque(torque_name(level)), measured_torque(level))
    for slip in SLIPS:
        yield _Derived(_mu_name(slip), "1", _mu(priors, slip), adhesion(slip, base))


def _constant(priors: Priors, name: str) -> Callable[[Mapping[str, float]], float]:
    return lambda values: float(getattr(priors.parameters(values), name))


def _torque(name: str) -> Callable[[Mapping[str, float]], float]:
    return lambda values: values["scale"] * values[name]


def _mu(priors: Priors, slip: float) -> Callable[[Mapping[str, float]], float]:
    return lambda values: AdhesionCurve(1.0, values["blend"]).adhesion(slip, priors.parameters(values))


def _mu_name(slip: float) -> str:
    return f"mu({slip:g})"


def _brake_map(points: Sequence[tuple[float, float]], base: RigParameters) -> dict[str, Any]:
    """The points of the brake map for a configuration, rising, and the straight line nearest to them.

    The beginning of the torque is not observed: it is set to the published end of the dead zone, or below the first
    duty if that is lower.
    """
    if len(points) < 2:
        return {}
    first = min(base.u0, points[0][0] - 0.01)
    duties, torques = [first], [0.0]
    for duty, torque in points:
        duties.append(duty)
        torques.append(max(torque, torques[-1] + _LEAST_SLOPE_NM))
    least = _WORKING_SHARE * torques[-1]
    working = [(duty, torque) for duty, torque in zip(duties, torques, strict=True) if torque >= least]
    own: dict[str, Any] = {"brake_duties": duties, "brake_torques_nm": torques}
    if len(working) > 1:
        b1, b2 = np.polyfit([duty for duty, _ in working], [torque for _, torque in working], 1)
        if b1 > 0.0:
            own |= {"b1": float(b1), "b2": float(b2), "u0": float(min(max(-b2 / b1, 0.0), 0.99))}
    return own
