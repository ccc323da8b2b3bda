"""What sessions say: replay, comparison, what-if, regression tests and statistics."""

from inteco_abs.analysis.baseline import previous_card
from inteco_abs.analysis.catalogue import COLUMNS, session_files, session_row, sort_rows
from inteco_abs.analysis.diff import SECTIONS, Change, Diff, SignalChange, diff_sessions, settings_of
from inteco_abs.analysis.gains import REFERENCE, changed_gains
from inteco_abs.analysis.replay import Difference, Replay, before_the_gap, replay, require_known
from inteco_abs.analysis.tolerance import Shift, Tolerance, parse_tolerances

__all__ = [
    "COLUMNS",
    "REFERENCE",
    "SECTIONS",
    "Change",
    "Diff",
    "Difference",
    "Replay",
    "Shift",
    "SignalChange",
    "Tolerance",
    "before_the_gap",
    "changed_gains",
    "diff_sessions",
    "parse_tolerances",
    "previous_card",
    "replay",
    "require_known",
    "session_files",
    "session_row",
    "settings_of",
    "sort_rows",
]
