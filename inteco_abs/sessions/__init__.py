"""Session files: writing, reading, validation, export and recovery."""

from inteco_abs.format import TICK, TRUTH, pack_tick
from inteco_abs.sessions.annotation import DESCRIPTION, HISTORY, annotate
from inteco_abs.sessions.attachments import attached, extract
from inteco_abs.sessions.card import (
    RunningCard,
    aligned_truth,
    card_of,
    computed_card,
    link_errors,
    result_card,
    stored_card,
)
from inteco_abs.sessions.channels import (
    WARNING,
    Channel,
    StateEvents,
    event_channel,
    gains_of,
    internals_of,
    pack_change,
    pack_event,
    pack_parameters,
    parameter_channel,
    result_channel,
    row_channel,
)
from inteco_abs.sessions.container import DamagedError
from inteco_abs.sessions.content import (
    CONFIG_NAME,
    CONTROLLER_FILES,
    CONTROLLER_SOURCE,
    RECOVERED,
    LogEntry,
    changes_among,
)
from inteco_abs.sessions.copying import write_copy
from inteco_abs.sessions.environment import Environment, current_environment
from inteco_abs.sessions.export import FORMATS, Export, export_session, export_target, write_parquet
from inteco_abs.sessions.failover_writer import FailoverWriter, Opener, check_spill, joined, spill_path
from inteco_abs.sessions.file_writer import FileWriter
from inteco_abs.sessions.files import (
    atomic_write,
    check_folder,
    check_output,
    check_session_file,
    ensured_directory,
    nearest_folder,
    require_own_file,
    write_file,
)
from inteco_abs.sessions.fingerprint import describe_other_arithmetic, other_arithmetic
from inteco_abs.sessions.frames import Frames, read_frames
from inteco_abs.sessions.locations import is_local, session_path
from inteco_abs.sessions.metrics import LOCKED_SLIP, LOWEST_RAD_S, STANDSTILL_RAD_S, Array, StopTrace, stop_metrics
from inteco_abs.sessions.migration import Metadata, newer
from inteco_abs.sessions.provenance import host_facts, profile_source, software_facts
from inteco_abs.sessions.reader import (
    Session,
    is_session_file,
    open_session,
    opened,
    read_metadata,
    read_session,
    session_config,
    stored_rows,
)
from inteco_abs.sessions.recovery import Recovery, recover_session
from inteco_abs.sessions.rows import BLOCK_TICKS, PhaseSpan, joined_rows
from inteco_abs.sessions.session_writer import EXIT_CODES, LOSSES, RunEnd, RunHeader, RunResult, SessionWriter
from inteco_abs.sessions.tables import Table, tables, to_pandas, to_polars
from inteco_abs.sessions.validation import Inspection, SessionIssue, Severity, validate

__all__ = [
    "BLOCK_TICKS",
    "CONFIG_NAME",
    "CONTROLLER_FILES",
    "CONTROLLER_SOURCE",
    "DESCRIPTION",
    "EXIT_CODES",
    "FORMATS",
    "HISTORY",
    "LOCKED_SLIP",
    "LOSSES",
    "LOWEST_RAD_S",
    "RECOVERED",
    "STANDSTILL_RAD_S",
    "TICK",
    "TRUTH",
    "WARNING",
    "Array",
    "Channel",
    "DamagedError",
    "Environment",
    "Export",
    "FailoverWriter",
    "FileWriter",
    "Frames",
    "Inspection",
    "LogEntry",
    "Metadata",
    "Opener",
    "PhaseSpan",
    "Recovery",
    "RunEnd",
    "RunHeader",
    "RunResult",
    "RunningCard",
    "Session",
    "SessionIssue",
    "SessionWriter",
    "Severity",
    "StateEvents",
    "StopTrace",
    "Table",
    "aligned_truth",
    "annotate",
    "atomic_write",
    "attached",
    "card_of",
    "changes_among",
    "check_folder",
    "check_output",
    "check_session_file",
    "check_spill",
    "computed_card",
    "current_environment",
    "describe_other_arithmetic",
    "ensured_directory",
    "event_channel",
    "export_session",
    "export_target",
    "extract",
    "gains_of",
    "host_facts",
    "internals_of",
    "is_local",
    "is_session_file",
    "joined",
    "joined_rows",
    "link_errors",
    "nearest_folder",
    "newer",
    "open_session",
    "opened",
    "other_arithmetic",
    "pack_change",
    "pack_event",
    "pack_parameters",
    "pack_tick",
    "parameter_channel",
    "profile_source",
    "read_frames",
    "read_metadata",
    "read_session",
    "recover_session",
    "require_own_file",
    "result_card",
    "result_channel",
    "row_channel",
    "session_config",
    "session_path",
    "software_facts",
    "spill_path",
    "stop_metrics",
    "stored_card",
    "stored_rows",
    "tables",
    "to_pandas",
    "to_polars",
    "validate",
    "write_copy",
    "write_file",
    "write_parquet",
]
