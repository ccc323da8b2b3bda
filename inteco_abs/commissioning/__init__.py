"""What a lab does around a run: commissioning a real board, in steps of rising risk."""

from inteco_abs.commissioning.mock_rig_access import MockBench, PacedMockBench
from inteco_abs.commissioning.operator import Person
from inteco_abs.commissioning.procedure import STEPS, Walk
from inteco_abs.commissioning.profile_draft import Draft
from inteco_abs.commissioning.rig_access import Bench, RealBench

__all__ = ["STEPS", "Bench", "Draft", "MockBench", "PacedMockBench", "Person", "RealBench", "Walk"]
