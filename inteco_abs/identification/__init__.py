"""The vendor's identification procedure as software: which runs to record, and what they say of the rig.

What counts can identify and what they cannot is explained in `fit_parameters`.
"""

from inteco_abs.identification.estimates import SLIPS, Identification, ParameterEstimate, identify
from inteco_abs.identification.parameters import ASSUMED, torque_name
from inteco_abs.identification.plan import PlannedRun, experiments
from inteco_abs.identification.segments import Segment, chosen, segment, segments

__all__ = [
    "ASSUMED",
    "SLIPS",
    "Identification",
    "ParameterEstimate",
    "PlannedRun",
    "Segment",
    "chosen",
    "experiments",
    "identify",
    "segment",
    "segments",
    "torque_name",
]
