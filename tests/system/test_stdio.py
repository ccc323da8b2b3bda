"""`run --stdio`: a program watches, tunes and stops a run, and the run outlives neither its commands nor its reader."""

import json
import subprocess

import pytest

from inteco_abs.sessions import read_session

pytestmark = [pytest.mark.untraced, pytest.mark.xdist_group("real time")]


def test_a_run_whose_commands_end_stops_in_safe(live):
    run = live("--stdio", stdin=subprocess.PIPE)
    run.process.stdin.write("Mk=3\nMk=-1\n")
    run.process.stdin.flush()
    run.until_tick(400)
    run.process.stdin.close()
    run.process.stdin = None  # communicate() would flush it
    printed, said = run.process.communicate(timeout=60)
    assert run.process.returncode == 130
    assert "the operator stopped the run" in said
    lines = [json.loads(line) for line in printed.splitlines()]
    assert [line["changed"]["value"] for line in lines if "changed" in line] == [3.0]
    assert [line for line in lines if "refused" in line]
    assert lines[-1]["card"]["outcome"] == "interrupted"
    truth = read_session(run.out).truth
    assert truth["drive"].max() == 1.0
    assert truth["drive"][-1] == truth["brake"][-1] == 0.0


@pytest.mark.long
def test_a_run_whose_reader_is_gone_ends_with_its_commands(live):
    run = live("--stdio", stdin=subprocess.PIPE)
    run.process.stdout.close()
    run.until_tick(400)
    run.process.stdin.close()
    run.process.stdin = run.process.stdout = None
    assert run.process.wait(60) == 130
    assert read_session(run.out).truth["drive"][-1] == 0.0
