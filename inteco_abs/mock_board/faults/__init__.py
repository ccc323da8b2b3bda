"""What may go wrong between host, board and rig: one vocabulary, for tests and for `--inject` of run and panel."""

from inteco_abs.mock_board.faults.device import FaultyDevice
from inteco_abs.mock_board.faults.fault import Event, Fault, Span, insist_on_possible, parse_fault, parse_faults
from inteco_abs.mock_board.faults.frontend import FaultyFace
from inteco_abs.mock_board.faults.host import FaultyHost
from inteco_abs.mock_board.faults.kinds import BY_PROCESS, CLOCK_STEP, KINDS, ON_THE_HOST, Kind
from inteco_abs.mock_board.faults.schedule import Schedule

__all__ = [
    "BY_PROCESS",
    "CLOCK_STEP",
    "KINDS",
    "ON_THE_HOST",
    "Event",
    "Fault",
    "FaultyDevice",
    "FaultyFace",
    "FaultyHost",
    "Kind",
    "Schedule",
    "Span",
    "insist_on_possible",
    "parse_fault",
    "parse_faults",
]
