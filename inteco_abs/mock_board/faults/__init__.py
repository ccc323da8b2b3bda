"""What may go wrong between host, board and rig: one vocabulary, for tests and for `inteco-abs run --inject`."""

from inteco_abs.mock_board.faults.device import FaultyDevice
from inteco_abs.mock_board.faults.face import FaultyFace
from inteco_abs.mock_board.faults.fault import Event, Fault, Span, parse_fault, parse_faults
from inteco_abs.mock_board.faults.host import FaultyHost
from inteco_abs.mock_board.faults.kinds import BY_PROCESS, CLOCK_STEP, KINDS, Kind
from inteco_abs.mock_board.faults.schedule import Schedule

__all__ = [
    "BY_PROCESS",
    "CLOCK_STEP",
    "KINDS",
    "Event",
    "Fault",
    "FaultyDevice",
    "FaultyFace",
    "FaultyHost",
    "Kind",
    "Schedule",
    "Span",
    "parse_fault",
    "parse_faults",
]
