"""A figure as PGF, which LaTeX typesets in the document's own fonts. Nothing of LaTeX is needed to write it."""

from __future__ import annotations

import re
from io import StringIO
from typing import TYPE_CHECKING, Any, Final

from matplotlib import rc_context
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.backends.backend_pgf import RendererPgf

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties

_DPI: Final = 72.0
_SPECIAL: Final = re.compile(r"[#$%&_{}]")
_NAMED: Final = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "−": r"\ensuremath{-}",
}
_HEAD: Final = r"""%% In the preamble:  \usepackage{{pgf}}
%% In the document:  \input{{{name}}}
\begingroup
\makeatletter
\begin{{pgfpicture}}
\pgfpathrectangle{{\pgfpointorigin}}{{\pgfqpoint{{{width:f}in}}{{{height:f}in}}}}
\pgfusepath{{use as bounding box, clip}}
"""
_TAIL: Final = "\\end{pgfpicture}\n\\makeatother\n\\endgroup\n"


def pgf_of(figure: Figure, name: str) -> str:
    """Return the figure as text of the file `name`."""
    out = StringIO()
    width, height = figure.get_size_inches()
    out.write(_HEAD.format(name=name, width=width, height=height))
    before = figure.dpi
    figure.dpi = _DPI
    try:
        with rc_context({"pgf.rcfonts": False}):
            figure.draw(_Renderer(figure, out))
    finally:
        figure.dpi = before
    out.write(_TAIL)
    return out.getvalue()


class _Renderer(RendererPgf):
    """Matplotlib's own asks LaTeX how wide each text is; LaTeX places texts anyway, by what they are aligned to."""

    def __init__(self, figure: Figure, out: StringIO) -> None:
        super().__init__(figure, out)
        self._metrics = RendererAgg(1, 1, _DPI)

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: Any) -> tuple[float, float, float]:
        width, height, descent = self._metrics.get_text_width_height_descent(s, prop, ismath)
        return width, height, descent

    def draw_text(
        self, gc: Any, x: float, y: float, s: str, prop: FontProperties, angle: float, ismath: Any = False,
        mtext: Any = None,
    ) -> None:  # fmt: skip
        # the document has a serif and a sans serif font; others it may not have
        generic = prop.copy()
        generic.set_family("serif" if "serif" in prop.get_family() else "sans-serif")
        text = s if ismath else "".join(_NAMED.get(each) or _SPECIAL.sub(r"\\\g<0>", each) for each in s)
        super().draw_text(gc, x, y, text, generic, angle, ismath, mtext)
