"""A matplotlib figure that a notebook shows without a magic command."""

from matplotlib.figure import Figure

from inteco_abs.views.shown import png_of


class InlineFigure(Figure):
    """Figure that is its own picture; after `%matplotlib inline` matplotlib draws it, and this is not asked."""

    def _repr_png_(self) -> bytes:
        return png_of(self)
