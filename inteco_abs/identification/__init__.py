"""Identification of a rig: which runs to record, and the parameters that explain them.

The module `parameters` explains what counts can identify.
"""

from inteco_abs.identification.estimates import (
    SLIPS,
    Identification,
    ParameterEstimate,
    check_parameter_file,
    identify,
)
from inteco_abs.identification.next_runs import next_runs
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
    "check_parameter_file",
    "chosen",
    "experiments",
    "identify",
    "next_runs",
    "segment",
    "segments",
    "torque_name",
]
