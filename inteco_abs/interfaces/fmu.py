"""The simulated rig as an FMU, a model that other simulation tools load: FMI 2.0 or 3.0, co-simulation, without Python.

Its C is that of the rig's own functions, so that it moves as `Plant` and reads as `Encoder` do, to the bit.
"""

from __future__ import annotations

import hashlib
import platform
import tempfile
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import Final
from uuid import UUID
from xml.etree import ElementTree as ET

from inteco_abs import elementary
from inteco_abs.c_code import CC, compiled_c, initializer, translated
from inteco_abs.errors import ConfigError
from inteco_abs.interfaces.fmu_variables import (
    FMI_VERSIONS,
    MODEL,
    STEP_S,
    Variable,
    c_of_variables,
    model_description,
    variables,
)
from inteco_abs.rig import LONGEST_DEAD_TIME_S, MOST_DELAY_TICKS, DriveMotor, RigVariation, mixed
from inteco_abs.rig.brake_actuator import settled
from inteco_abs.rig.model import rim_slip
from inteco_abs.rig.plant import move_on, read_encoders
from inteco_abs.rig.state import Constants, State, contact_rate
from inteco_abs.sessions import check_output, write_file

_FUNCTIONS: Final = (move_on, read_encoders, rim_slip, settled, contact_rate, mixed, elementary.sin_cos)
_ON_THE_WAY: Final = round(LONGEST_DEAD_TIME_S / STEP_S) + 2
"""Commands that a brake's dead time can hold: one for each step."""
_EXPORTED_ONLY: Final = "-fvisibility=hidden"


def export_fmu(
    out: str | Path, rig: RigVariation | None = None, motor: DriveMotor | None = None, *, fmi: str = FMI_VERSIONS[-1]
) -> None:
    """Write the FMU `out` of a rig, the published one by default; its numbers are the parameters' start values.

    `fmi` is "2.0" or "3.0". Raises ConfigError for another or for a path where no new .fmu file can be written, and
    AbsError without a C compiler, or for a number that this version of FMI cannot hold.
    """
    out = Path(out)
    if fmi not in FMI_VERSIONS:
        raise ConfigError.of("fmi", f"{fmi!r}: must be one of {', '.join(FMI_VERSIONS)}")
    if out.suffix != ".fmu":
        raise ConfigError.of("OUT", f"{out}: must end in .fmu")
    check_output(out, "OUT")
    rig, motor = rig or RigVariation(), motor or DriveMotor()
    found = variables(rig, motor)
    source = _source(found, Constants.of(rig, motor))
    with tempfile.TemporaryDirectory() as folder:
        library, archive = Path(folder, MODEL), Path(folder, "fmu")
        token = str(UUID(hashlib.sha256(source.encode()).hexdigest()[:32]))
        source = f'#define TOKEN "{token}"\n{source}'
        parts = {"modelDescription.xml": model_description(fmi, token, found), f"sources/{MODEL}.c": source.encode()}
        compiled_c(source, library, _EXPORTED_ONLY)
        parts[f"binaries/{_platform(fmi)}/{MODEL}.so"] = library.read_bytes()
        if fmi != "2.0":
            parts["sources/buildDescription.xml"] = _build_description(fmi)
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            for name, data in parts.items():
                file.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)  # the same bytes every time
        write_file(out, archive.read_bytes())


def _source(found: list[Variable], k: Constants) -> str:
    numbers = {"ROOM": _ON_THE_WAY, "MOST_DELAY": MOST_DELAY_TICKS, "VARIABLE_COUNT": len(found)}
    defined = [f"#define {name} {number}\n" for name, number in numbers.items()]
    starts = {"k.max_step_s": initializer(STEP_S), "s": initializer(State.at_speeds(k, 0.0, 0.0)), "token": "TOKEN"}
    own = files("inteco_abs.interfaces").joinpath("rig_fmu.c").read_text(encoding="utf-8")
    parts = [*defined, f"#define STEP_S {initializer(STEP_S)}\n", translated(_FUNCTIONS), own]
    return "".join([*parts, c_of_variables(found, starts)])


def _platform(fmi: str) -> str:
    """Name of the binary's folder."""
    machine = platform.machine()
    return "linux64" if fmi == "2.0" and machine == "x86_64" else f"{machine}-linux"


def _build_description(fmi: str) -> bytes:
    root = ET.Element("fmiBuildDescription", fmiVersion=fmi)
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=MODEL)
    options = " ".join(option for option in CC if option.startswith(("-O", "-f")))
    sources = ET.SubElement(build, "SourceFileSet", language="C99", compilerOptions=options)
    ET.SubElement(sources, "SourceFile", name=f"{MODEL}.c")
    ET.SubElement(build, "Library", name="m")
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text
