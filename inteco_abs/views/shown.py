"""Results that show themselves: as a table on a terminal, as figure and table in a notebook."""

from __future__ import annotations

import base64
import io
from abc import ABC, abstractmethod
from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Final

from rich.console import Console, RenderableType

from inteco_abs.errors import AbsError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMNS: Final = 110
_BLOCK: Final = '<pre style="line-height:1.2;font-family:monospace">{code}</pre>'
_SCREEN_DPI: Final = 110.0


class Shown(ABC):
    """A result with a table and a figure."""

    __slots__ = ()

    @abstractmethod
    def __rich__(self) -> RenderableType:
        """The result as rich prints it on a terminal."""

    @abstractmethod
    def plot(self) -> Figure:
        """The result as a figure. Raises AbsError without matplotlib."""

    def _repr_html_(self) -> str:
        return f"<p><b>{escape(repr(self))}</b></p>{_picture(self.plot)}{html_of(self.__rich__())}"


def html_of(*renderables: RenderableType) -> str:
    """What rich prints, as HTML."""
    # in a notebook, rich would show it by itself, too
    console = Console(
        record=True, file=io.StringIO(), width=_COLUMNS, markup=False, highlight=False, force_jupyter=False
    )
    console.print(*renderables, sep="\n")
    return console.export_html(inline_styles=True, code_format=_BLOCK)


def _picture(plot: Callable[[], Figure]) -> str:
    try:
        figure = plot()
    except AbsError as error:  # there is nothing to draw, or no matplotlib
        return f"<p>{escape(str(error))}</p>"
    data = base64.b64encode(png_of(figure)).decode()
    return f'<p><img alt="" src="data:image/png;base64,{data}"></p>'


def png_of(figure: Figure) -> bytes:
    """The figure for a screen."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=_SCREEN_DPI)
    return data.getvalue()
