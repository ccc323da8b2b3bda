"""Commissioning of a real board in steps of rising risk, the manual panel, and the preflight of a dry run."""

from inteco_abs.commissioning.anonymous_report import board_seen
from inteco_abs.commissioning.identity import hex_dump
from inteco_abs.commissioning.mock_rig_access import MockRigAccess, PacedMockRigAccess
from inteco_abs.commissioning.operator import Operator, require_phrase
from inteco_abs.commissioning.outputs import CONFIRMED_OFF, PROVES_ITSELF
from inteco_abs.commissioning.panel import AGAIN, PHRASE, REQUEST, Output, Panel
from inteco_abs.commissioning.preflight import Preflight, planned_phases, run_preflight
from inteco_abs.commissioning.procedure import STEPS, Procedure, find_step
from inteco_abs.commissioning.profile_draft import ProfileDraft
from inteco_abs.commissioning.rig_access import RealRigAccess, RigAccess
from inteco_abs.commissioning.step import StepContext

__all__ = [
    "AGAIN",
    "CONFIRMED_OFF",
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
    "find_step",
    "hex_dump",
    "planned_phases",
    "require_phrase",
    "run_preflight",
]
