"""The table of hazards is complete and true, and its page is generated from it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from inteco_abs.mock_board.faults import parse_fault
from inteco_abs.signals import Reason

ROOT = Path(__file__).parents[2]
HAZARDS = tomllib.loads((ROOT / "tests/faults/hazards.toml").read_text(encoding="utf-8"))["hazard"]
INJECTIONS = [(row["number"], each) for row in HAZARDS for each in row.get("inject", ())]
EXPLAINED = {"completes", "warned", *(reason.name for reason in Reason)}


def test_hazards_are_numbered_consecutively():
    assert [row["number"] for row in HAZARDS] == list(range(1, len(HAZARDS) + 1))


@pytest.mark.parametrize("row", HAZARDS, ids=lambda row: str(row["number"]))
def test_a_hazard_says_who_does_what_how_soon_and_what_proves_it(row):
    assert row["layer"] in {"software", "board", "switch"}
    assert row["name"]
    assert row["does"].endswith(".")
    assert row["bound"]
    assert row["tests"] or row.get("inject")
    for name in (*row["tests"], *row.get("open_board", {}).get("tests", ())):
        assert (ROOT / name).is_file(), name


@pytest.mark.parametrize(("number", "injection"), INJECTIONS)
def test_an_injection_can_be_parsed_and_ends_in_a_known_way(number, injection):
    assert set(injection["ends"]) <= EXPLAINED, number
    for fault in " ".join(injection["faults"]).split():
        kind, _, lasts = fault.partition("@")
        for at in injection["at"]:
            parse_fault(f"{kind}@{at}{lasts}")
    harmless = injection["ends"] == ["completes"] or "BRAKING_TIMEOUT" in injection["ends"]
    assert harmless or {"bound_ms", "warned_ms"} & set(injection), "nothing would be demanded of it"


def test_every_reason_that_takes_outputs_away_is_a_hazards_end():
    met = {end for _, each in INJECTIONS for end in each["ends"]}
    elsewhere = {"NONE", "OPERATOR_STOP", "BAD_OUTPUT", "CONTROLLER_ERROR", "GUARDIAN_LOST",
                 "SUPERVISOR_LOST", "RECORDER_LOST"}  # fmt: skip
    assert met - {"completes", "warned"} | elsewhere == {reason.name for reason in Reason}


def test_a_fault_on_the_page_can_be_typed_as_it_stands_there():
    page = (ROOT / "docs/hazards.md").read_text(encoding="utf-8")
    cells = [line.split(" | ")[-1] for line in page.splitlines() if line.startswith("| ")][1:]
    faults = [fault for cell in cells for entry in re.findall(r"`([^`]+)`", cell) for fault in entry.split()]
    assert faults
    for fault in faults:
        parse_fault(fault)


@pytest.mark.parametrize("tool", ["write_hazards"])
def test_the_page_is_what_the_table_says(tool):
    subprocess.run([sys.executable, ROOT / "tools" / tool, "--check"], check=True)
