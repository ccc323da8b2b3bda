"""The memory: what a session holds, how it is written, read, judged and replayed."""

from inteco_abs.records import TICK, TRUTH, pack_tick
from inteco_abs.sessions.reader import Session, read_session
from inteco_abs.sessions.recorder import Recorder, check_output
from inteco_abs.sessions.replay import CONFIG_NAME, Difference, Replay, changed_gains, replay, session_config
from inteco_abs.sessions.result import result_card
from inteco_abs.sessions.scribe import Account, Conclusion, Introduction, Scribe
from inteco_abs.sessions.tolerance import Shift, Tolerance, parse_tolerances

__all__ = [
    "CONFIG_NAME",
    "TICK",
    "TRUTH",
    "Account",
    "Conclusion",
    "Difference",
    "Introduction",
    "Recorder",
    "Replay",
    "Scribe",
    "Session",
    "Shift",
    "Tolerance",
    "changed_gains",
    "check_output",
    "pack_tick",
    "parse_tolerances",
    "read_session",
    "replay",
    "result_card",
    "session_config",
]
