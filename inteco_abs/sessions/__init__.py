"""Session files: how they are written, read, judged, exported and recovered."""

from inteco_abs.format import TICK, TRUTH, pack_tick
from inteco_abs.sessions.attachments import attached, extract
from inteco_abs.sessions.card import result_card, stored_card
from inteco_abs.sessions.export import FORMATS, Export, export_session
from inteco_abs.sessions.failover_writer import FailoverWriter, check_spill, spill_path
from inteco_abs.sessions.files import (
    atomic_write,
    check_folder,
    check_output,
    ensured_directory,
    nearest_folder,
    require_own_file,
)
from inteco_abs.sessions.frames import Frames, read_frames
from inteco_abs.sessions.reader import Session, is_session_file, read_session
from inteco_abs.sessions.recorded_config import CONFIG_NAME, session_config
from inteco_abs.sessions.recovery import Recovery, recover_session
from inteco_abs.sessions.session_writer import EXIT_CODES, LOSSES, RunEnd, RunHeader, RunResult, SessionWriter
from inteco_abs.sessions.tables import Table, tables, to_pandas, to_polars
from inteco_abs.sessions.validation import Finding, Inspection, Severity, validate
from inteco_abs.sessions.writer import FileWriter

__all__ = [
    "CONFIG_NAME",
    "EXIT_CODES",
    "FORMATS",
    "LOSSES",
    "TICK",
    "TRUTH",
    "Export",
    "FailoverWriter",
    "FileWriter",
    "Finding",
    "Frames",
    "Inspection",
    "Recovery",
    "RunEnd",
    "RunHeader",
    "RunResult",
    "Session",
    "SessionWriter",
    "Severity",
    "Table",
    "atomic_write",
    "attached",
    "check_folder",
    "check_output",
    "check_spill",
    "ensured_directory",
    "export_session",
    "extract",
    "is_session_file",
    "nearest_folder",
    "pack_tick",
    "read_frames",
    "read_session",
    "recover_session",
    "require_own_file",
    "result_card",
    "session_config",
    "spill_path",
    "stored_card",
    "tables",
    "to_pandas",
    "to_polars",
    "validate",
]
