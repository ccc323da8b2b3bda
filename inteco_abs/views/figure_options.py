"""What a figure of stops can look like: sizes and fonts of journals, panels, a part of the time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, SupportsFloat

from inteco_abs.errors import ConfigError, ConfigIssue, near_match, shortened

PANELS: Final = ("speed", "slip", "torque")
WIDTHS: Final = ("one", "two")
SMALLEST_PT: Final = 5.0
LARGEST_PT: Final = 20.0
_HEAD_MM: Final = 25.0
"""Of the height: title or names above, and the time axis below."""
_FAMILIES: Final = {
    "serif": ("Times New Roman", "Nimbus Roman", "TeX Gyre Termes", "Liberation Serif", "STIXGeneral"),
    "sans": ("Arial", "Helvetica", "Nimbus Sans", "TeX Gyre Heros", "Liberation Sans", "DejaVu Sans"),
}
"""Fonts of the same widths, best first; matplotlib brings the last one of each."""
_GENERIC: Final = {"serif": "serif", "sans": "sans-serif"}


class FigureSize(NamedTuple):
    """Size of a figure with all panels, its font, and letters in a line of its labels."""

    width_mm: float
    height_mm: float
    font_pt: float
    label_letters: int


class FigureStyle(NamedTuple):
    """What a journal asks for."""

    widths: dict[str, FigureSize]
    """By number of columns."""
    font: str | None
    """`serif` or `sans`; None is matplotlib's own, the same on every computer."""
    title: bool
    """Journals have a caption instead."""
    legend: str
    """Size of legends, beside that of the text: journals have a smallest one."""
    units: str
    """How an axis names its unit."""


STYLES: Final = {
    "plain": FigureStyle(
        {"one": FigureSize(88.0, 135.0, 7.0, 56), "two": FigureSize(180.0, 165.0, 8.0, 115)},
        None, True, "small", "[{}]",
    ),
    # docs/sessions.md#figures-for-a-paper has the sources
    "ieee": FigureStyle(
        {"one": FigureSize(88.9, 140.0, 9.0, 56), "two": FigureSize(182.0, 165.0, 9.0, 115)},
        "serif", False, "small", "({})",
    ),
    "elsevier": FigureStyle(
        {"one": FigureSize(90.0, 135.0, 7.0, 56), "two": FigureSize(190.0, 165.0, 7.0, 130)},
        "sans", False, "medium", "({})",
    ),
}  # fmt: skip


def within(value: object, least: float, most: float) -> bool:
    """Whether it is a number in this range."""
    return isinstance(value, SupportsFloat) and least <= float(value) <= most


def range_issues(range_s: object) -> Iterator[ConfigIssue]:
    """What is wrong with the part of the time that is shown; None is all of it."""
    if range_s is not None:
        pair = list(range_s) if isinstance(range_s, Iterable) else []
        numbers = all(within(each, -math.inf, math.inf) and math.isfinite(each) for each in pair)
        if len(pair) != 2 or not numbers or not pair[0] < pair[1]:
            problem = f"{shortened(range_s)}: must be two times that rise, s since braking began"
            yield ConfigIssue("--range", problem)


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureOptions:
    """Options of a figure of stops. Raises ConfigError for a value that it cannot have."""

    width: str = "two"
    style: str = "plain"
    font: str | None = None
    """`serif`, `sans`, or the name of an installed font; None is the style's."""
    font_size_pt: float | None = None
    title: bool | None = None
    """Whether one session has a title, or as the style has it."""
    panels: Sequence[str] = PANELS
    range_s: tuple[float, float] | None = None
    """Begin and end, s since braking began; None is from 0.2 s before to the end."""
    envelope: bool = True
    """Whether torque that chatters is drawn as its range and mean."""

    def __post_init__(self) -> None:
        issues = [*self._choices(), *self._numbers()]
        if issues:
            raise ConfigError(issues)

    def _choices(self) -> Iterable[ConfigIssue]:
        for option, value, choices in (("--width", self.width, WIDTHS), ("--style", self.style, STYLES)):
            if value not in choices:
                yield ConfigIssue(option, f"{value!r}: must be one of {', '.join(choices)}")
        given: object = self.panels  # a caller's mistake
        named = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else []
        unknown = [panel for panel in named if panel not in PANELS]
        if unknown or not named:
            problem = f"{shortened(self.panels)}: must be one or several of {', '.join(PANELS)}"
            yield ConfigIssue("--panels", problem)

    def _numbers(self) -> Iterable[ConfigIssue]:
        size = self.font_size_pt
        if size is not None and not within(size, SMALLEST_PT, LARGEST_PT):
            yield ConfigIssue("--font-size", f"{size!r}: must be in {SMALLEST_PT:g}..{LARGEST_PT:g} pt")
        yield from range_issues(self.range_s)

    @property
    def size(self) -> FigureSize:
        """Size of the figure with its panels, and font size."""
        whole = STYLES[self.style].widths[self.width]
        height_mm = _HEAD_MM + (whole.height_mm - _HEAD_MM) * len(self.drawn) / len(PANELS)
        return whole._replace(height_mm=height_mm, font_pt=self.font_size_pt or whole.font_pt)

    @property
    def drawn(self) -> list[str]:
        """The panels in their order."""
        return [panel for panel in PANELS if panel in self.panels]

    @property
    def titled(self) -> bool:
        """Whether one session has a title."""
        return STYLES[self.style].title if self.title is None else self.title

    @property
    def legend(self) -> str:
        """Size of legends, as matplotlib names it."""
        return STYLES[self.style].legend

    def with_unit(self, name: str, unit: str) -> str:
        """Label of an axis."""
        return f"{name} {STYLES[self.style].units.format(unit)}"

    def rc(self) -> Any:
        """Matplotlib's parameters. Raises ConfigError for a font that is not installed."""
        font = self.font or STYLES[self.style].font
        families = {} if font is None else {"font.family": _installed(font)}
        return {"font.size": self.size.font_pt, "axes.linewidth": 0.6, **families}


def _installed(font: str) -> list[str]:
    """The font that is installed, and what stands in for letters that it has not, or where an SVG is opened without it.

    Raises ConfigError.
    """
    from matplotlib.font_manager import fontManager  # noqa: PLC0415  heavy, and an extra

    names = {each.name for each in fontManager.ttflist}
    if font in _FAMILIES:
        return [next(name for name in _FAMILIES[font] if name in names), _GENERIC[font]]
    if font not in names:
        hint = near_match(str(font), names)
        problem = f"{font}: not an installed font{hint}; serif and sans are there everywhere"
        raise ConfigError.of("--font", problem)
    return [font, "serif" if "serif" in font.lower().replace("sans serif", "") else "sans-serif"]
