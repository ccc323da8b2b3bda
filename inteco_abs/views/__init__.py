"""Result card, live dashboard, figures and reports."""

from inteco_abs.views.result_panel import render_card

__all__ = ["render_card"]
