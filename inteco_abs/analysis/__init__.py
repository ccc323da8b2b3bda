"""Analysis of sessions: replay, comparison, what-if, regression tests and statistics."""

from inteco_abs.analysis.arithmetic import recorded_arithmetic
from inteco_abs.analysis.baseline import previous_card
from inteco_abs.analysis.catalogue import COLUMNS, session_files, session_row, session_rows, sort_rows
from inteco_abs.analysis.closed_loop import Continuation, continued
from inteco_abs.analysis.dataset import write_dataset
from inteco_abs.analysis.diff import SECTIONS, Change, Diff, SignalChange, diff_sessions, require_sections, settings_of
from inteco_abs.analysis.gains import changed_gains, gain_changes, listed_changes, recorded_gains, times_of_changes_ns
from inteco_abs.analysis.golden import Golden, GoldenFolder, GoldenResult
from inteco_abs.analysis.open_loop import WhatIf, alternative, braking_start, since_braking_s, what_if
from inteco_abs.analysis.publication import Publication, publish
from inteco_abs.analysis.replay import (
    FirstDifference,
    Replay,
    before_the_gap,
    decisions,
    replay_recorded,
    replay_session,
    require_known,
)
from inteco_abs.analysis.stop_statistics import UNITS, MetricStatistics, metric_statistics
from inteco_abs.analysis.tolerance import Shift, Tolerance, parse_tolerances

__all__ = [
    "COLUMNS",
    "SECTIONS",
    "UNITS",
    "Change",
    "Continuation",
    "Diff",
    "FirstDifference",
    "Golden",
    "GoldenFolder",
    "GoldenResult",
    "MetricStatistics",
    "Publication",
    "Replay",
    "Shift",
    "SignalChange",
    "Tolerance",
    "WhatIf",
    "alternative",
    "before_the_gap",
    "braking_start",
    "changed_gains",
    "continued",
    "decisions",
    "diff_sessions",
    "gain_changes",
    "listed_changes",
    "metric_statistics",
    "parse_tolerances",
    "previous_card",
    "publish",
    "recorded_arithmetic",
    "recorded_gains",
    "replay_recorded",
    "replay_session",
    "require_known",
    "require_sections",
    "session_files",
    "session_row",
    "session_rows",
    "settings_of",
    "since_braking_s",
    "sort_rows",
    "times_of_changes_ns",
    "what_if",
    "write_dataset",
]
