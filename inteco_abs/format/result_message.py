"""The result card as a message at the end of each session, for programs that do not read metadata."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from inteco_abs.format.descriptors import INT64, TEXT, field, message, proto_file
from inteco_abs.format.protobuf import chunk, double, integer
from inteco_abs.format.schema import DOUBLE, PACKAGE

RESULT_TOPIC: Final = "/abs/result"
_WORD: Final = (1 << 64) - 1
RESULT_NAME: Final = f"{PACKAGE}.Result"


class ResultField(NamedTuple):
    """One value of the card. Fields are numbered from 1 in the order of `RESULT`; new ones are appended."""

    name: str
    """As in the card; `lateness_us_p50` is its `lateness_us["p50"]`."""
    kind: int = DOUBLE.type_number
    unit: str = "1"
    """As in UCUM; empty for a text."""


RESULT: Final = (
    ResultField("session", TEXT, ""),
    ResultField("outcome", TEXT, ""),
    ResultField("reason", TEXT, ""),
    ResultField("explanation", TEXT, ""),
    ResultField("board", TEXT, ""),
    ResultField("rig", TEXT, ""),
    ResultField("controller", TEXT, ""),
    ResultField("estimator", TEXT, ""),
    ResultField("ticks", INT64),
    ResultField("overruns", INT64),
    ResultField("lost_ticks", INT64),
    ResultField("link_errors", INT64),
    ResultField("stops", INT64),
    ResultField("start_speed_rad_s", unit="rad/s"),
    ResultField("reference_slip"),
    ResultField("reaching_time_s", unit="s"),
    ResultField("band_entry_s", unit="s"),
    ResultField("stop_time_s", unit="s"),
    ResultField("stop_distance_m", unit="m"),
    ResultField("slip_rms_true"),
    ResultField("slip_rms_estimated"),
    ResultField("slip_rms_low_speed_true"),
    ResultField("slip_rms_fixed_true"),
    ResultField("lock_fraction"),
    ResultField("torque_variation_nm_per_s", unit="N.m/s"),
    ResultField("duty_variation_per_s", unit="1/s"),
    ResultField("lateness_us_p50", unit="us"),
    ResultField("lateness_us_p99", unit="us"),
    ResultField("lateness_us_p999", unit="us"),
    ResultField("lateness_us_max", unit="us"),
    ResultField("payload_sha256", TEXT, ""),
    ResultField("swing_share"),
    ResultField("fall_backs"),
    ResultField("fall_back_from_s", unit="s"),
    ResultField("fall_back_s", unit="s"),
)


def result_descriptor() -> bytes:
    """Schema of `/abs/result`."""
    fields = [field(entry.name, number, entry.kind) for number, entry in enumerate(RESULT, 1)]
    return chunk(1, proto_file(f"{RESULT_NAME}.proto", PACKAGE, chunk(4, message("Result", fields))))


def pack_result(card: Mapping[str, Any]) -> bytes:
    """The card as a message. An unknown number is NaN, as a missing field is read as 0."""
    late = {f"lateness_us_{name}": value for name, value in card["lateness_us"].items()}
    values = {**card, **late}
    return b"".join(_field(number, entry, values.get(entry.name)) for number, entry in enumerate(RESULT, 1))


def _field(number: int, entry: ResultField, value: Any) -> bytes:
    if entry.kind == DOUBLE.type_number:
        return double(number, math.nan if value is None else value)
    if value is None:
        return b""
    return integer(number, value & _WORD) if entry.kind == INT64 else chunk(number, value)
