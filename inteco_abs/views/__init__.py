"""What a person sees: result card and figures."""

from inteco_abs.views.card import render_card

__all__ = ["render_card"]
