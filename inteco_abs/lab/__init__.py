"""What a lab does around a run: commissioning a real board, in steps of rising risk."""

from inteco_abs.lab.bench import Bench, RealBench
from inteco_abs.lab.draft import Draft
from inteco_abs.lab.mock_bench import MockBench, PacedMockBench
from inteco_abs.lab.person import Person
from inteco_abs.lab.walk import STEPS, Walk

__all__ = ["STEPS", "Bench", "Draft", "MockBench", "PacedMockBench", "Person", "RealBench", "Walk"]
