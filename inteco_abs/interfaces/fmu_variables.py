"""The variables of the rig's FMU, and its model description for FMI 2.0 and 3.0."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as ET

from inteco_abs.c_code import initializer
from inteco_abs.errors import AbsError
from inteco_abs.rig import ENCODER_RANGES, RIG_RANGES, ROADS, DriveMotor, RigVariation, described
from inteco_abs.version import __version__

MODEL: Final = "inteco_abs_rig"
"""Name of the binary, and the model's identifier."""
STEP_S: Final = 0.0005
"""Internal step: that of the plant's integrator, and a tick of a loop at 2 kHz."""
_UNITS: Final[dict[str, dict[str, int]]] = {
    "m": {"m": 1},
    "s": {"s": 1},
    "1/s": {"s": -1},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "kg.m2": {"kg": 1, "m": 2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N.m.s": {"kg": 1, "m": 2, "s": -1},
}
_SKIPPED: Final = ("parameters", "wheel_encoder", "road_encoder", "brake_map", "road", "later_road", "seed")
_ANGLE: Final = (-1e6, 1e6)
_SPEED: Final = (-1e3, 1e3)
_LEAST: Final = 1e-6
"""Of what the model divides by."""
_RANGES: Final = {
    **RIG_RANGES,
    **ENCODER_RANGES,
    "load_ripple_phase_rad": _ANGLE,
    "eccentricity_phase_rad": _ANGLE,
    "second_harmonic_phase_rad": _ANGLE,
    "damage_angle_rad": _ANGLE,
    "phi_rad": _ANGLE,
    **dict.fromkeys(("r1", "r2", "L", "J1", "J2", "Mg", "a", "p", "b1", "no_load_speed_rad_s"), (_LEAST, 1e6)),
    **dict.fromkeys(("d1", "d2", "M10", "M20", "stall_torque_nm"), (0.0, 1e6)),
    **dict.fromkeys(("w1", "w2", "w3", "w4", "b2"), (-1e3, 1e3)),
    "c31": (_LEAST, math.inf),
    "u0": (0.0, 1.0),
    **dict.fromkeys(("road_c1", "later_c1"), (0.0, 2.0)),
    **dict.fromkeys(("road_c2", "later_c2"), (0.0, 1e3)),
    **dict.fromkeys(("road_c3", "later_c3"), (-2.0, 2.0)),
}
_UNLIMITED: Final = (-math.inf, math.inf)
_KINDS: Final = {"float": "FLOAT", "int": "INTEGER", "bool": "FLAG"}
_TYPES: Final = {
    "2.0": {"FLOAT": "Real", "INTEGER": "Integer", "WORD": "Integer", "FLAG": "Boolean"},
    "3.0": {"FLOAT": "Float64", "INTEGER": "Int64", "WORD": "UInt64", "FLAG": "Boolean"},
}
FMI_VERSIONS: Final = tuple(_TYPES)
_MOST: Final = {"2.0": (1 << 31) - 1, "3.0": (1 << 64) - 1}
"""Largest integer."""


class Variable(NamedTuple):
    """A variable, whose value reference is its number in `variables`."""

    name: str
    place: str
    """In the C of struct rig."""
    meaning: str
    kind: str = "FLOAT"
    causality: str = "output"
    unit: str = ""
    limits: tuple[float, float] = _UNLIMITED
    start: Any = None


def variables(rig: RigVariation, motor: DriveMotor) -> list[Variable]:
    """Time, inputs, outputs and parameters, which start as those of this rig."""
    return [
        Variable("time", "time_s", "Time", causality="independent", unit="s"),
        Variable("drive_duty", "drive_duty", "Duty of the drive", causality="input", limits=(0.0, 1.0), start=0.0),
        Variable("brake_duty", "brake_duty", "Duty of the brake", causality="input", limits=(0.0, 1.0), start=0.0),
        Variable("wheel_count", "wheel_count", "Count of the wheel's encoder", "INTEGER"),
        Variable("road_count", "road_count", "Count of the road's encoder", "INTEGER"),
        Variable("wheel_speed", "s.wheel_speed", "Speed of the upper wheel, the braked one", unit="rad/s"),
        Variable("road_speed", "s.road_speed", "Speed of the lower wheel, the road", unit="rad/s"),
        Variable("slip", "slip", "True slip in 0..1, equation (7) of the paper"),
        Variable("brake_torque", "s.brake_torque", "Torque that the brake can hold", unit="N.m"),
        *(_start_speed(wheel) for wheel in ("wheel", "road")),
        *_parameters(rig.parameters),
        *_parameters(rig, skipped=_SKIPPED),
        _parameter(
            "measured_map", "FLAG", "Brake's map as measured in the manual, not a line", rig.brake_map != "line"
        ),
        *_road("road", rig.road),
        *_road("later", rig.later_road),
        *_parameters(rig.wheel_encoder, "wheel_encoder."),
        *_parameters(rig.road_encoder, "road_encoder."),
        *_parameters(motor),
        _parameter("seed", "WORD", "Seed of the encoders' noise", rig.seed)._replace(place="seed"),
    ]


def _road(name: str, road: str) -> Iterator[Variable]:
    of_it = "the road's adhesion; 0 for the rig's own" if name == "road" else "the later road's adhesion; 0 for none"
    for i, start in enumerate(ROADS[road], 1):
        yield _parameter(f"{name}_c{i}", "FLOAT", f"Coefficient c{i} of {of_it}", start)


def _start_speed(wheel: str) -> Variable:
    name, meaning = f"initial_{wheel}_speed", f"Speed of the {wheel} at the start"
    return Variable(name, name, meaning, "FLOAT", "parameter", "rad/s", _SPEED, 0.0)


def _parameter(name: str, kind: str, meaning: str, start: object) -> Variable:
    field = name.rpartition(".")[2]
    limits = (0.0, math.inf) if kind in {"WORD", "FLAG"} else _RANGES[field]
    return Variable(name, f"k.{name}", meaning, kind, "parameter", "", limits, start)


def _parameters(record: Any, prefix: str = "", skipped: tuple[str, ...] = ()) -> Iterator[Variable]:
    """The numbers of a dataclass."""
    for (name, unit, meaning), kind, value in described(record):
        if name not in skipped:
            found = _parameter(prefix + name, _KINDS[kind], meaning, value)
            yield found._replace(unit=unit if unit in _UNITS else "")


def model_description(version_of_fmi: str, token: str, found: list[Variable]) -> bytes:
    """The file modelDescription.xml. Raises AbsError for a number that is too large for this version."""
    second = version_of_fmi == "2.0"
    root = ET.Element(
        "fmiModelDescription",
        {"fmiVersion": version_of_fmi, "modelName": "Inteco ABS rig", "guid" if second else "instantiationToken": token}
        | {"description": "Two wheels, brake and drive of the Inteco anti-lock braking rig, with its encoders"}
        | {"generationTool": f"inteco-abs {__version__}"}
        | ({"variableNamingConvention": "structured", "numberOfEventIndicators": "0"} if second else {})
        | ({} if second else {"variableNamingConvention": "structured"}),
    )
    able = {"canHandleVariableCommunicationStepSize": "true"}
    if second:
        able |= {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
        own = ET.SubElement(
            root, "CoSimulation", {"modelIdentifier": MODEL, **able} | {"canNotUseMemoryManagementFunctions": "true"}
        )
        ET.SubElement(ET.SubElement(own, "SourceFiles"), "File", name=f"{MODEL}.c")
    else:
        able |= {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true", "fixedInternalStepSize": repr(STEP_S)}
        ET.SubElement(root, "CoSimulation", {"modelIdentifier": MODEL, **able})
    units = ET.SubElement(root, "UnitDefinitions")
    for unit, exponents in _UNITS.items():
        base = {name: str(exponent) for name, exponent in exponents.items()}
        ET.SubElement(ET.SubElement(units, "Unit", name=unit), "BaseUnit", base)
    log = ET.SubElement(root, "LogCategories")
    ET.SubElement(log, "Category", name="logStatusError")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime="10.0", stepSize=repr(STEP_S))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(found):
        _write(listed, version_of_fmi, str(reference), variable)
    _write_structure(root, found, second=second)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _write(listed: ET.Element, fmi: str, reference: str, variable: Variable) -> None:
    name, _, meaning, kind, causality, unit, limits, start = variable
    of_kind = {"unit": unit} if unit else {}
    if kind in {"FLOAT", "INTEGER"}:
        ends = zip(("min", "max"), limits, strict=True)
        of_kind |= {end: _text(limit) for end, limit in ends if math.isfinite(limit)}
    if start is not None:
        if kind in {"INTEGER", "WORD"} and start > _MOST[fmi]:
            raise AbsError(f"{name} = {start}: FMI {fmi} has integers up to {_MOST[fmi]}; use FMI {FMI_VERSIONS[-1]}")
        of_kind["start"] = _text(start)
    variability = {"parameter": "fixed"}.get(causality, "continuous" if kind == "FLOAT" else "discrete")
    common = {"name": name, "valueReference": reference, "causality": causality, "variability": variability}
    common |= {"description": meaning, **({"initial": "calculated"} if causality == "output" else {})}
    if fmi == "2.0":
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", common), _TYPES[fmi][kind], of_kind)
    else:
        ET.SubElement(listed, _TYPES[fmi][kind], common | of_kind)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return "INF" if value == math.inf else repr(value)


def _write_structure(root: ET.Element, found: list[Variable], *, second: bool) -> None:
    """The outputs depend on no input of the same time."""
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [i for i, variable in enumerate(found) if variable.causality == "output"]
    for tag in ("Outputs", "InitialUnknowns") if second else ("Output", "InitialUnknown"):
        parent = ET.SubElement(structure, tag) if second else structure
        for i in outputs:
            known = {} if tag.startswith("Initial") else {"dependencies": ""}
            if second:
                ET.SubElement(parent, "Unknown", {"index": str(i + 1), **known})
            else:
                ET.SubElement(parent, tag, {"valueReference": str(i), **known})


def c_of_variables(found: list[Variable], starts: Mapping[str, str]) -> str:
    """The start values, `starts` among them, and the table that the FMU's C looks them up in."""
    given = {variable.place: variable.start for variable in found if variable.start is not None}
    places = [f"    .{place} = {initializer(value)}," for place, value in given.items()]
    places += [f"    .{place} = {text}," for place, text in starts.items()]
    rows = [
        f'    {{"{v.name}", offsetof(struct rig, {v.place}), {v.kind}, {v.causality.upper()},'
        f" {initializer(float(v.limits[0]))}, {initializer(float(v.limits[1]))}}},"
        for v in found
    ]
    return "\n".join([
        "static const struct rig START = {", *places, "};", "",
        "static const struct variable VARIABLES[VARIABLE_COUNT] = {", *rows, "};", "",
    ])  # fmt: skip
