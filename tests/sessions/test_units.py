"""Units that sessions and exports have are valid UCUM."""

import json
import re
from pkgutil import resolve_name

import pytest

from inteco_abs.control import CONTROLLERS
from inteco_abs.format import RESULT, TICK, TRUTH
from inteco_abs.published import PUBLISHED
from inteco_abs.sessions import tables

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


def test_gains_carry_unit_and_meaning(quick):
    facts = quick.session.channels["/abs/params"]
    units, meanings = json.loads(facts["units"]), json.loads(facts["describe"])
    (values,) = [each.values for each in quick.session.parameters]
    assert units.keys() == meanings.keys() == values.keys()
    assert (units["Mk"], units["lag_s"], units["reference_slip"]) == ("1/s", "s", "1")
