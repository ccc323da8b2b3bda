"""Session files: how they are written, read, judged, exported and recovered."""

from inteco_abs.format import TICK, TRUTH, pack_tick
from inteco_abs.sessions.attachments import attached, extract
from inteco_abs.sessions.card import result_card, stored_card
from inteco_abs.sessions.export import FORMATS, Export, export_session
from inteco_abs.sessions.failover_writer import Keeper, check_spill, spill_path
from inteco_abs.sessions.files import (
    check_folder,
    check_output,
    insist_on_own,
    made_folder,
    nearest_folder,
    only_whole,
)
from inteco_abs.sessions.frames import Frames, read_frames
from inteco_abs.sessions.reader import Session, is_session_file, read_session
from inteco_abs.sessions.recorded_config import CONFIG_NAME, session_config
from inteco_abs.sessions.recovery import Recovery, recover_session
from inteco_abs.sessions.session_writer import EXIT_CODES, LOSSES, Account, Conclusion, Introduction, Scribe
from inteco_abs.sessions.tables import Table, tables, to_pandas, to_polars
from inteco_abs.sessions.validation import Finding, Inspection, Severity, validate
from inteco_abs.sessions.writer import Recorder

__all__ = [
    "CONFIG_NAME",
    "EXIT_CODES",
    "FORMATS",
    "LOSSES",
    "TICK",
    "TRUTH",
    "Account",
    "Conclusion",
    "Export",
    "Finding",
    "Frames",
    "Inspection",
    "Introduction",
    "Keeper",
    "Recorder",
    "Recovery",
    "Scribe",
    "Session",
    "Severity",
    "Table",
    "attached",
    "check_folder",
    "check_output",
    "check_spill",
    "export_session",
    "extract",
    "insist_on_own",
    "is_session_file",
    "made_folder",
    "nearest_folder",
    "only_whole",
    "pack_tick",
    "read_frames",
    "read_session",
    "recover_session",
    "result_card",
    "session_config",
    "spill_path",
    "stored_card",
    "tables",
    "to_pandas",
    "to_polars",
    "validate",
]
