"""Reproduction of the paper: its two stops, its law beside constant-rate control, and where its recipe breaks."""

from inteco_abs.paper.cases import Condition, Law, conditions
from inteco_abs.paper.comparison import Comparison, compare, verdict
from inteco_abs.paper.reproduction import PaperRow, PaperTrace, Reproduction, reproduce

__all__ = [
    "Comparison",
    "Condition",
    "Law",
    "PaperRow",
    "PaperTrace",
    "Reproduction",
    "compare",
    "conditions",
    "reproduce",
    "verdict",
]
