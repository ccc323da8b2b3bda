"""Faults between host, board and rig, for tests and for `--inject` of run and panel."""

from inteco_abs.mock_board.faults.device import FaultyDevice
from inteco_abs.mock_board.faults.fault import Fault, FaultEvent, Span, parse_fault, parse_faults, require_possible
from inteco_abs.mock_board.faults.frontend import FaultyFrontEnd
from inteco_abs.mock_board.faults.host import FaultyHost
from inteco_abs.mock_board.faults.kinds import BY_PROCESS, CLOCK_STEP, KINDS, ON_THE_HOST, FaultKind
from inteco_abs.mock_board.faults.schedule import Schedule

__all__ = [
    "BY_PROCESS",
    "CLOCK_STEP",
    "KINDS",
    "ON_THE_HOST",
    "Fault",
    "FaultEvent",
    "FaultKind",
    "FaultyDevice",
    "FaultyFrontEnd",
    "FaultyHost",
    "Schedule",
    "Span",
    "parse_fault",
    "parse_faults",
    "require_possible",
]
