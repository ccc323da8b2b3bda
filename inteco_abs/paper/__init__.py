"""Reproduction of the paper: its two stops, its law beside constant-rate control, and where its recipe breaks."""

from inteco_abs.paper.cases import Law, PaperCondition, paper_conditions
from inteco_abs.paper.comparison import Comparison, compare, verdict
from inteco_abs.paper.reproduction import PaperRow, PaperTrace, Reproduction, reproduce

__all__ = [
    "Comparison",
    "Law",
    "PaperCondition",
    "PaperRow",
    "PaperTrace",
    "Reproduction",
    "compare",
    "paper_conditions",
    "reproduce",
    "verdict",
]
