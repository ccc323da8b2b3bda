"""The memory: what a session holds, how it is written, read, judged, replayed, compared and rescued."""

from inteco_abs.records import TICK, TRUTH, pack_tick
from inteco_abs.sessions.diff import SECTIONS, Change, Diff, SignalChange, diff_sessions, settings_of
from inteco_abs.sessions.export import FORMATS, Export, export_session
from inteco_abs.sessions.extract import attached, extract
from inteco_abs.sessions.frames import Frames, read_frames
from inteco_abs.sessions.gains import REFERENCE, changed_gains
from inteco_abs.sessions.keeper import Keeper, check_spill, spill_path
from inteco_abs.sessions.listing import COLUMNS, session_files, session_row, sort_rows
from inteco_abs.sessions.output import (
    check_folder,
    check_output,
    insist_on_own,
    made_folder,
    nearest_folder,
    only_whole,
)
from inteco_abs.sessions.previous import previous_card
from inteco_abs.sessions.reader import Session, is_session_file, read_session
from inteco_abs.sessions.recorder import Recorder
from inteco_abs.sessions.replay import (
    CONFIG_NAME,
    Difference,
    Replay,
    before_the_gap,
    insist_on_known,
    replay,
    session_config,
)
from inteco_abs.sessions.result import result_card, stored_card
from inteco_abs.sessions.salvage import Recovery, recover_session
from inteco_abs.sessions.scribe import EXIT_CODES, LOSSES, Account, Conclusion, Introduction, Scribe
from inteco_abs.sessions.tables import Table, tables, to_pandas, to_polars
from inteco_abs.sessions.tolerance import Shift, Tolerance, parse_tolerances
from inteco_abs.sessions.validation import Finding, Inspection, Severity, validate

__all__ = [
    "COLUMNS",
    "CONFIG_NAME",
    "EXIT_CODES",
    "FORMATS",
    "LOSSES",
    "REFERENCE",
    "SECTIONS",
    "TICK",
    "TRUTH",
    "Account",
    "Change",
    "Conclusion",
    "Diff",
    "Difference",
    "Export",
    "Finding",
    "Frames",
    "Inspection",
    "Introduction",
    "Keeper",
    "Recorder",
    "Recovery",
    "Replay",
    "Scribe",
    "Session",
    "Severity",
    "Shift",
    "SignalChange",
    "Table",
    "Tolerance",
    "attached",
    "before_the_gap",
    "changed_gains",
    "check_folder",
    "check_output",
    "check_spill",
    "diff_sessions",
    "export_session",
    "extract",
    "insist_on_known",
    "insist_on_own",
    "is_session_file",
    "made_folder",
    "nearest_folder",
    "only_whole",
    "pack_tick",
    "parse_tolerances",
    "previous_card",
    "read_frames",
    "read_session",
    "recover_session",
    "replay",
    "result_card",
    "session_config",
    "session_files",
    "session_row",
    "settings_of",
    "sort_rows",
    "spill_path",
    "stored_card",
    "tables",
    "to_pandas",
    "to_polars",
    "validate",
]
