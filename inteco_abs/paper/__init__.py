"""Reproduction of the paper: its two stops, its law compared with constant-rate control, and the law's limits."""

from inteco_abs.paper.cases import Law, PaperCondition, paper_conditions
from inteco_abs.paper.comparison import Comparison, Similarity, compare, compare_with_simulation, verdict
from inteco_abs.paper.reproduction import PaperRow, PaperTrace, Reproduction, reproduce

__all__ = [
    "Comparison",
    "Law",
    "PaperCondition",
    "PaperRow",
    "PaperTrace",
    "Reproduction",
    "Similarity",
    "compare",
    "compare_with_simulation",
    "paper_conditions",
    "reproduce",
    "verdict",
]
