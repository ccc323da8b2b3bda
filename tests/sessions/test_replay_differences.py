import math
import struct
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from inteco_abs.analysis import FirstDifference, changed_gains
from inteco_abs.errors import SessionError
from inteco_abs.format.schema import Role
from inteco_abs.sessions import TICK, FileWriter, read_session
from inteco_abs.signals import Phase, Reason

OUTPUTS = [column for column in TICK.columns if column.role is Role.OUTPUT]
REAL = [column.name for column in OUTPUTS if column.kind.code == "d"]
WHOLE = [column.name for column in OUTPUTS if column.kind.code != "d"]
TIMING = [column.name for column in TICK.columns if column.role is Role.TIMING]


def row_in(session, phase, offset=20):
    """Number of a tick well inside a phase."""
    return int(np.flatnonzero(session.ticks["phase"] == phase)[offset])


def last_bit_changed(value):
    (bits,) = struct.unpack("<Q", struct.pack("<d", value))
    return struct.unpack("<d", struct.pack("<Q", bits ^ 1))[0]


def one(tick, field, logged, replayed):
    """The finding when this one output of a tick is not what was logged."""
    hexes = [value.hex() if isinstance(value, float) else hex(value) for value in (logged, replayed)]
    return 1, FirstDifference(tick, field, repr(logged), repr(replayed), *hexes), {field: 1}


def finding(found):
    return found.differing, found.first, found.by_field


def test_which_fields_are_compared_is_not_nothing():
    assert {"brake", "drive", "slip", "phase", "reason", "torque_demand_nm", "brake_request"} <= {*REAL, *WHOLE}


@pytest.mark.parametrize("field", REAL)
def test_the_last_bit_of_any_logged_number_is_found(quick, retouched, replayed, field):
    session = quick.session
    row = row_in(session, Phase.BRAKING)
    right = session.ticks[field][row].item()
    wrong = last_bit_changed(right)
    found = replayed(retouched(session, row, **{field: wrong}))
    assert finding(found) == one(row, field, wrong, right)
    assert found.first.logged_hex != found.first.replayed_hex


@pytest.mark.parametrize(("field", "wrong"), [("phase", int(Phase.FAULT)), ("reason", int(Reason.BAD_OUTPUT))])
def test_another_logged_phase_or_reason_is_found(quick, retouched, replayed, field, wrong):
    session = quick.session
    row = row_in(session, Phase.SPIN_UP)
    right = session.ticks[field][row].item()
    assert finding(replayed(retouched(session, row, **{field: wrong}))) == one(row, field, wrong, right)


def test_another_logged_truth_value_is_found(quick, retouched, replayed):
    found = replayed(retouched(quick.session, 100, estimate_valid=False))
    assert finding(found) == (
        1,
        FirstDifference(100, "estimate_valid", "False", "True", "0x0", "0x1"),
        {"estimate_valid": 1},
    )


@pytest.mark.parametrize("row", [0, -1], ids=["first", "last"])
def test_a_difference_in_the_first_and_in_the_last_tick_is_found(quick, retouched, replayed, row):
    session = quick.session
    found = replayed(retouched(session, row, switching=0.125))
    assert finding(found) == one(row % len(session.ticks), "switching", 0.125, 0.0)


def test_minus_zero_is_not_zero(quick, retouched, replayed):
    found = replayed(retouched(quick.session, 5, drive=-0.0))
    assert finding(found) == (1, FirstDifference(5, "drive", "-0.0", "0.0", "-0x0.0p+0", "0x0.0p+0"), {"drive": 1})


def test_two_nans_are_equal(quick, retouched, replayed):
    """Most ticks have no reference slip; where something else differs they must not be counted."""
    session = quick.session
    assert int(np.isnan(session.ticks["slip_reference"]).sum()) > 500
    assert replayed(retouched(session, 5, drive=0.5)).by_field == {"drive": 1}


@pytest.mark.parametrize(("phase", "wrong", "right"), [(Phase.IDLE, 0.2, math.nan), (Phase.BRAKING, math.nan, 0.2)])
def test_nan_is_not_a_number(quick, retouched, replayed, phase, wrong, right):
    session = quick.session
    row = row_in(session, phase)
    found = replayed(retouched(session, row, slip_reference=wrong))
    assert found.first == one(row, "slip_reference", wrong, right)[1]
    assert found.by_field == {"slip_reference": 1}


def test_the_first_of_several_differences_is_named_and_all_are_counted(quick, retouched, replayed):
    session = quick.session
    row = row_in(session, Phase.BRAKING)
    wrong = retouched(session, row + 7, brake=0.125, slip=0.5)
    wrong = retouched(wrong, row + 9, brake=0.125)
    found = replayed(wrong)
    assert (found.differing, found.by_field) == (2, {"slip": 1, "brake": 2})
    assert (found.first.tick, found.first.field, found.first.logged) == (row + 7, "slip", "0.5")


def test_the_number_of_the_tick_is_named_not_its_row(quick, replayed):
    session = quick.session
    payload = bytearray(session.payload)
    ticks = np.frombuffer(payload, TICK.dtype)
    ticks["tick"][:] += 1000
    ticks["drive"][3] = 0.5
    found = replayed(session.with_rows(TICK.array(bytes(payload))))
    assert (found.differing, found.first.tick) == (1, 1003)


@pytest.mark.parametrize(("count", "speed"), [("wheel_count", "wheel_speed_rad_s"), ("road_count", "road_speed_rad_s")])
def test_one_bit_of_a_logged_count_is_found(quick, retouched, replayed, count, speed):
    session = quick.session
    row = row_in(session, Phase.BRAKING, 200)
    before = session.ticks[count][row].item()
    found = replayed(retouched(session, row, **{count: before ^ 1}))
    logged = session.ticks[speed][row].item()
    step = ((before ^ 1) - before) * 2.0 * math.pi / 2048 / 0.010  # one count over the window of 10 ms
    assert (found.first.tick, found.first.field) == (row, speed)
    assert (found.first.logged, found.first.logged_hex) == (repr(logged), logged.hex())
    assert float(found.first.replayed) == pytest.approx(logged + step, rel=1e-12)
    assert float.fromhex(found.first.replayed_hex) == float(found.first.replayed)
    assert found.by_field[speed] >= 2  # it enters the window and leaves it again
    assert found.differing >= found.by_field[speed]


def test_one_bit_of_a_count_in_a_file_is_found(quick, retouched, replayed, tmp_path):
    session = quick.session
    row = row_in(session, Phase.SPIN_UP, 100)
    changed = retouched(session, row, road_count=session.ticks["road_count"][row].item() ^ 1)
    path = tmp_path / "changed.mcap"
    with FileWriter(path, 0) as recorder:
        recorder.attach("config.toml", "application/toml", session.attachments["config.toml"])
        recorder.begin({})
        recorder.ticks(changed.payload)
        recorder.finish("completed", "no fault", quick.stop.card)
    found = replayed(read_session(path))
    assert (found.first.tick, found.first.field) == (row, "road_speed_rad_s")


def flipped(session, row, name):
    """The value of a column with its lowest bit flipped."""
    value = session.ticks[name][row].item()
    return last_bit_changed(value) if isinstance(value, float) else value ^ 1


FOUND_AS = {
    "time_ns": "time_ns",
    "tick": "tick",
    "dt_s": "dt_s",
    "wheel_count": "wheel_speed_rad_s",
    "road_count": "road_speed_rad_s",
    "board_flags": "wheel_speed_rad_s",
    "stop_request": "phase",
}
"""By input, the first field that is not what the log says."""


def test_every_input_is_tried():
    assert set(FOUND_AS) == {column.name for column in TICK.columns if column.role is Role.INPUT}


@pytest.mark.parametrize("phase", [Phase.SPIN_UP, Phase.BRAKING])
@pytest.mark.parametrize("name", FOUND_AS)
def test_one_bit_of_any_logged_input_is_found_and_named(quick, retouched, replayed, name, phase):
    session = quick.session
    row = row_in(session, phase, 200)
    found = replayed(retouched(session, row, **{name: flipped(session, row, name)}))
    assert found.first.field == FOUND_AS[name]
    at_once = name != "board_flags"  # a flagged sample may have the value that is held in its place, for a tick
    assert row <= found.first.tick <= row + (0 if at_once else 2)


def test_a_wrong_time_is_reported_with_the_right_one(quick, retouched, replayed):
    session = quick.session
    row = row_in(session, Phase.BRAKING)
    right = session.ticks["time_ns"][row].item()
    found = replayed(retouched(session, row, time_ns=right + 1024))
    assert (found.first.logged, found.first.replayed) == (str(right + 1024), str(right))


def test_a_tick_that_is_missing_is_found_at_the_next_one(quick, replayed):
    session = quick.session
    payload = b"".join([session.payload[: 10 * TICK.size], session.payload[11 * TICK.size :]])
    found = replayed(session.with_rows(TICK.array(payload)))
    assert (found.first.tick, found.first.field, found.first.replayed) == (10, "tick", "10")


def test_an_operators_stop_that_was_logged_is_taken(quick, retouched, replayed):
    session = quick.session
    row = row_in(session, Phase.SPIN_UP)
    found = replayed(retouched(session, row, stop_request=int(Reason.OPERATOR_STOP)))
    assert (found.first.tick, found.first.field) == (row, "phase")
    assert (found.first.logged, found.first.replayed) == (str(int(Phase.SPIN_UP)), str(int(Phase.FAULT)))
    assert found.by_field["reason"] == len(session.ticks) - row


@pytest.mark.parametrize("field", TIMING)
def test_timing_is_not_judged(quick, retouched, replayed, field):
    assert replayed(retouched(quick.session, 7, **{field: 3})).differing == 0


def with_gains(session, **gains):
    """The session with other gains in its configuration."""
    table = tomllib.loads(session.attachments["config.toml"].decode())
    table["controller"]["gains"] = gains
    return replace(session, attachments={"config.toml": tomli_w.dumps(table).encode()})


@pytest.mark.parametrize("gains", [{"Mk": 2.5}, {"Mq": 0.75}], ids=["Mk", "Mq"])
def test_another_gain_in_the_attached_configuration_is_found(quick, replayed, gains):
    session = quick.session
    found = replayed(with_gains(session, **gains))
    first_update = row_in(session, Phase.BRAKING, 1)  # nothing is asked for in the first tick of braking
    assert (found.first.tick, found.first.field) == (first_update, "torque_demand_nm")
    logged = session.ticks["torque_demand_nm"][first_update].item()
    assert (found.first.logged, found.first.logged_hex) == (repr(logged), logged.hex())
    assert found.first.replayed != found.first.logged
    assert found.first.replayed_hex == float(found.first.replayed).hex()
    assert "slip" not in found.by_field


def test_the_last_bit_of_a_gain_is_found(quick, replayed):
    found = replayed(with_gains(quick.session, Mk=math.nextafter(2.0, 3.0)))
    assert found.first.field == "torque_demand_nm"
    logged, again = float.fromhex(found.first.logged_hex), float.fromhex(found.first.replayed_hex)
    assert logged != again
    assert again == pytest.approx(logged, rel=1e-14)


def test_gains_named_with_their_recorded_values_differ_in_nothing(quick, replayed):
    assert replayed(with_gains(quick.session, Mk=2.0, Mq=1.0)).differing == 0


IN_FORCE = {"reference_slip": 0.2, "Mk": 2.0, "Mq": 1.0, "lag_s": 0.0}


def test_gains_that_the_session_has_recorded_otherwise_are_reported(quick):
    session = quick.session
    assert changed_gains(session, IN_FORCE) == {}
    changed = changed_gains(session, IN_FORCE | {"Mq": math.nextafter(1.0, 2.0), "unknown": 3.0})
    where = "metadata controller: gain.Mq.hex"
    change = {"recorded": "0x1.0000000000000p+0", "configured": "0x1.0000000000001p+0", "where": where}
    assert changed == {"Mq": change}


def test_a_gain_that_the_controller_no_longer_has_is_reported(quick):
    change = changed_gains(quick.session, {name: value for name, value in IN_FORCE.items() if name != "lag_s"})["lag_s"]
    assert (change["recorded"], change["configured"]) == ("0.0", None)


def test_a_session_that_has_recorded_no_gains_has_none_that_changed(quick):
    assert changed_gains(replace(quick.session, metadata={}, parameters=()), IN_FORCE) == {}


def test_a_session_without_ticks_cannot_be_replayed(quick, replayed):
    session = quick.session
    with pytest.raises(SessionError, match="has no ticks"):
        replayed(session.with_rows(session.ticks[:0]))


def test_a_session_without_its_configuration_cannot_be_replayed(quick, replayed):
    with pytest.raises(SessionError, match=r"has no config\.toml"):
        replayed(replace(quick.session, attachments={}))


@pytest.mark.parametrize(
    ("stored", "words"),
    [
        (b"\xff\xfe", r"config\.toml cannot be used here"),
        (b"not = = toml", "is not TOML"),
        (b"", "board: is missing"),
        (b'[controller]\nname = "sliding"\n', "no controller 'sliding'"),
    ],
    ids=["bytes", "text", "empty", "unknown controller"],
)
def test_a_session_whose_configuration_cannot_be_used_says_why(quick, replayed, stored, words):
    with pytest.raises(SessionError, match=words):
        replayed(replace(quick.session, attachments={"config.toml": stored}))
