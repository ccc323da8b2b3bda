"""Roads as text: what a simulated rig brakes on, from stop to stop."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Final

from inteco_abs.rig.variation import ROADS, RigVariation

OWN: Final = "own"
"""Name of the rig's own adhesion curve."""
_ROADS: Final = ", ".join(filter(None, ROADS))
_NUMBER: Final = r"[0-9]{1,6}(?:\.[0-9]{1,6})?"
_PART: Final = re.compile(rf"(?P<name>[a-z-]+)?(?:\*(?P<factor>{_NUMBER}))?(?:@(?P<after>{_NUMBER})(?P<unit>ms|s))?")
_SECONDS: Final = {"ms": 1e-3, "s": 1.0}
_EXAMPLE: Final = "as in own, ice, own*0.6, dry-asphalt>ice@300ms, own>*0.5@0.4s"


def on_road(rig: RigVariation, text: str) -> RigVariation:
    """`rig` on the road that `text` names: one of `ROADS`, or `own`, with a factor on its adhesion if one follows.

    `ROAD>ROAD@TIME` or `ROAD>*FACTOR@TIME` changes it that long after the brake came on. Raises ValueError with what is
    wrong and what is allowed.
    """
    first, arrow, later = text.replace(" ", "").partition(">")
    name, factor, after_s = _part(first)
    if name not in {OWN, *ROADS} or not name or after_s is not None:
        raise ValueError(f"{text!r}: must begin with a road, one of {OWN}, {_ROADS}; {_EXAMPLE}")
    if name != OWN:
        rig = replace(rig, road=name)
    if factor is not None:
        rig = replace(rig, adhesion_scale=rig.adhesion_scale * factor)
    if not arrow:
        return rig
    name, factor, after_s = _part(later)
    if not after_s or (name is None) == (factor is None) or (name is not None and (name == OWN or name not in ROADS)):
        problem = f"behind the > must stand one of {_ROADS}, or *FACTOR, and then @TIME in ms or s"
        raise ValueError(f"{text!r}: {problem}; {_EXAMPLE}")
    if factor is None:
        return replace(rig, later_road=name or "", later_road_after_s=after_s)
    rig = replace(rig, second_grip_step_after_s=0.0, third_grip_step_after_s=0.0)
    return replace(rig, grip_step=factor - 1.0, grip_step_after_s=after_s)


def _part(text: str) -> tuple[str | None, float | None, float | None]:
    """Name, factor and time in s of a part, each None where it is not given; an unknown name for what is not one."""
    found = _PART.fullmatch(text)
    if found is None:
        return "?", None, None
    factor = float(found["factor"]) if found["factor"] else None
    after_s = float(found["after"]) * _SECONDS[found["unit"]] if found["after"] else None
    return found["name"], factor, after_s
