"""The paper again: its two stops, its law beside constant-rate control, and where its recipe breaks."""

from inteco_abs.paper.cases import Condition, Law, conditions
from inteco_abs.paper.comparison import Comparison, compare, verdict
from inteco_abs.paper.reproduction import Course, Reproduction, Row, reproduce

__all__ = [
    "Comparison",
    "Condition",
    "Course",
    "Law",
    "Reproduction",
    "Row",
    "compare",
    "conditions",
    "reproduce",
    "verdict",
]
