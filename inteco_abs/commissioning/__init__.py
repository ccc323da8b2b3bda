"""What a lab does around a run: commissioning a real board, in steps of rising risk."""

from inteco_abs.commissioning.mock_rig_access import MockRigAccess, PacedMockRigAccess
from inteco_abs.commissioning.operator import Operator
from inteco_abs.commissioning.procedure import STEPS, Procedure
from inteco_abs.commissioning.profile_draft import ProfileDraft
from inteco_abs.commissioning.rig_access import RealRigAccess, RigAccess

__all__ = [
    "STEPS",
    "MockRigAccess",
    "Operator",
    "PacedMockRigAccess",
    "Procedure",
    "ProfileDraft",
    "RealRigAccess",
    "RigAccess",
]
