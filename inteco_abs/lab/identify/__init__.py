"""The vendor's identification procedure as software: which runs to record, and what they say of the rig.

What counts can tell and what they cannot is explained in `unknowns`.
"""

from inteco_abs.lab.identify.estimates import SLIPS, Estimate, Identification, identify
from inteco_abs.lab.identify.plan import Experiment, experiments
from inteco_abs.lab.identify.segments import Segment, chosen, segment, segments
from inteco_abs.lab.identify.unknowns import ASSUMED, torque_name

__all__ = [
    "ASSUMED",
    "SLIPS",
    "Estimate",
    "Experiment",
    "Identification",
    "Segment",
    "chosen",
    "experiments",
    "identify",
    "segment",
    "segments",
    "torque_name",
]
