"""What a lab does around a run: commissioning a real board, in steps of rising risk."""

from inteco_abs.commissioning.board_report import board_seen
from inteco_abs.commissioning.identity import hex_dump
from inteco_abs.commissioning.mock_rig_access import MockRigAccess, PacedMockRigAccess
from inteco_abs.commissioning.operator import Operator, require_phrase
from inteco_abs.commissioning.outputs import PROVES_ITSELF
from inteco_abs.commissioning.panel import AGAIN, PHRASE, REQUEST, Output, Panel
from inteco_abs.commissioning.preflight import Preflight, course, look_at
from inteco_abs.commissioning.procedure import STEPS, Procedure, find_step
from inteco_abs.commissioning.profile_draft import ProfileDraft
from inteco_abs.commissioning.rig_access import RealRigAccess, RigAccess
from inteco_abs.commissioning.step import StepContext

__all__ = [
    "AGAIN",
    "PHRASE",
    "PROVES_ITSELF",
    "REQUEST",
    "STEPS",
    "MockRigAccess",
    "Operator",
    "Output",
    "PacedMockRigAccess",
    "Panel",
    "Preflight",
    "Procedure",
    "ProfileDraft",
    "RealRigAccess",
    "RigAccess",
    "StepContext",
    "board_seen",
    "course",
    "find_step",
    "hex_dump",
    "look_at",
    "require_phrase",
]
