"""Units that sessions and exports have are valid UCUM."""

import json
import re
from dataclasses import asdict
from pkgutil import resolve_name

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS
from inteco_abs.format import RESULT, TICK, TRUTH
from inteco_abs.mock_board import simulated_rig
from inteco_abs.published import PUBLISHED
from inteco_abs.rig import MEASURED_MAP, nominal_parameters
from inteco_abs.sessions import session_config, tables
from inteco_abs.sessions.rig_numbers import rig_numbers

ATOMS = "m|s|g|K|A|cd|rad|N|J|W|Hz|V"
PREFIXES = "n|u|m|k|M"
SIMPLE = rf"(?:(?:{PREFIXES})?(?:{ATOMS})|1)(?:[+-]?[1-9]\d*)?(?:\{{[!-z|~]*\}})?|\{{[!-z|~]*\}}"
TERM = rf"(?:{SIMPLE})(?:[./](?:{SIMPLE}))*"
UNIT = re.compile(rf"{TERM}(?:/\({TERM}\))?")
"""The grammar of UCUM as far as units of this project need it: no terms in terms, no brackets in atoms."""


@pytest.mark.parametrize("unit", ["1", "rad/s2", "kg.m2", "N-2.m-2", "1/(s.N.m)", "{count}", "us", "m{road}/s"])
def test_the_grammar_knows_valid_units(unit):
    assert UNIT.fullmatch(unit)


@pytest.mark.parametrize("unit", ["counts", "text", "", "N m", "(N m)2", "1/(N m)2", "s^2", "rpm", "m//s", "{count"])
def test_the_grammar_refuses_others(unit):
    assert not UNIT.fullmatch(unit)


def test_units_of_all_columns_results_gains_and_internals_are_valid():
    laws = {**CONTROLLERS, **{name: resolve_name(place) for name, place in PUBLISHED.items()}}
    units = {f"{message.name} {column.name}": column.unit for message in (TICK, TRUTH) for column in message.columns}
    units |= {f"result {entry.name}": entry.unit for entry in RESULT}
    units |= {f"{law} {each.name}": each.unit for law, kind in laws.items() for each in (*kind.gains, *kind.internals)}
    wrong = {name: unit for name, unit in units.items() if unit and not UNIT.fullmatch(unit)}
    assert not wrong
    assert {name for name, unit in units.items() if not unit and "Tick" in name} == {
        f"{TICK.name} c{number}" for number in range(4)
    }


def test_units_of_a_session_and_its_tables_are_valid(quick):
    session = quick.session
    for facts in session.channels.values():
        assert all(UNIT.fullmatch(unit) for unit in json.loads(facts.get("units", "{}")).values())
    for table in tables(session):
        assert all(UNIT.fullmatch(unit) for unit in table.units.values() if unit)
    texts = {name for table in tables(session) for name, unit in table.units.items() if not unit}
    assert texts == {"text", "c3"}


def test_the_rigs_numbers_stand_in_the_file_with_units(run):
    session = run("model.identified.J1=0.008", "simulation.rig='hard:3'").session
    content = json.loads(session.attachments["rig.json"], parse_constant=pytest.fail)
    numbers = [*content["nominal"].values(), *content["simulated"].values()]
    units = [unit for each in numbers for unit in (each["unit"] if isinstance(each["unit"], list) else [each["unit"]])]
    assert all(UNIT.fullmatch(unit) for unit in units)
    assert all(each["meaning"] for each in numbers)
    nominal, drawn = content["nominal"], simulated_rig(session_config(session, ()))
    own = asdict(nominal_parameters(session_config(session, ()).model))
    assert {name: nominal[name]["value"] for name in own} == own
    assert (nominal["J1"]["value"], nominal["J1"]["unit"]) == (0.008, "kg.m2")
    assert [tuple(point) for point in nominal["brake_map"]["value"]] == list(MEASURED_MAP.points)
    assert content["simulated"]["J1"]["value"] == drawn.parameters.J1 != 0.008
    assert content["simulated"]["brake_dead_time_s"] == {
        "value": drawn.brake_dead_time_s,
        "unit": "s",
        "meaning": "Dead time of the brake, 0..0.2 s; the lag c31 comes on top.",
    }
    assert content["simulated"]["stall_torque_nm"]["unit"] == "N.m"
    assert session.media_types["rig.json"] == "application/json"


def test_a_real_rig_has_no_simulated_numbers_but_the_motor_that_was_identified():
    motor = "model.identified.drive_stall_torque_nm=1.5", "model.identified.drive_no_load_speed_rad_s=290.0"
    config = load_config(settings=motor)
    content = json.loads(rig_numbers(config, simulated=False), parse_constant=pytest.fail)
    assert content.keys() == {"nominal"}
    assert content["nominal"]["no_load_speed_rad_s"]["value"] == 290.0


def test_gains_carry_unit_and_meaning(quick):
    facts = quick.session.channels["/abs/params"]
    units, meanings = json.loads(facts["units"]), json.loads(facts["describe"])
    (values,) = [each.values for each in quick.session.parameters]
    assert units.keys() == meanings.keys() == values.keys()
    assert (units["Mk"], units["lag_s"], units["reference_slip"]) == ("1/s", "s", "1")
