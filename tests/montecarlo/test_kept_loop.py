"""Loops of machine code that are kept on disk as object files."""

import importlib
import os
import subprocess
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest

from inteco_abs import kept_loop
from inteco_abs.kept_loop import KeptLoop
from inteco_abs.records import record

ADDING = "def add_rows(parts, gain, rows):\n    for i in range(rows.size):\n        rows[i].y = rows[i].x * gain + "
ROWS = np.dtype([("x", np.float64), ("y", np.float64)])


@dataclass
class Offset:
    offset: float = 1.0
    calls: int = 0


class Parts(NamedTuple):
    offset: object


@pytest.fixture
def added(tmp_path, monkeypatch):
    """What a loop of a file has added to three rows in a process without such code, or None if it did not."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))

    def run(added, *, may_make=False, result="True"):
        text = f"import numpy as np\n{ADDING}{added}\n    parts.offset.calls += 1\n    return {result}\n"
        (tmp_path / "adding_file.py").write_text(text)
        monkeypatch.delitem(sys.modules, "adding_file", raising=False)
        importlib.invalidate_caches()
        monkeypatch.setattr(kept_loop, "_LOADED", {})
        loop = KeptLoop(importlib.import_module("adding_file").add_rows, may_make=may_make)
        offset, rows = record(Offset()), np.array([(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)], ROWS).view(np.recarray)
        done = [loop.run(Parts(offset), 10.0, rows) for _ in range(2)]
        assert done[0] is done[1]
        assert offset.calls == 2 or not done[0]
        return rows.y.tolist() if done[0] else None

    return run


def test_a_loop_is_loaded_until_its_source_changes(added):
    assert added("parts.offset.offset") is None
    assert added("parts.offset.offset", may_make=True) == [11.0, 21.0, 31.0]
    assert added("parts.offset.offset") == [11.0, 21.0, 31.0]
    assert added("parts.offset.offset * 2.0") is None


def test_a_loop_that_leaves_the_rest_to_python_or_cannot_be_made_says_so(added):
    assert added("1.0", may_make=True, result="False") is None
    assert added("1.0", may_make=True, result="1.0 / parts.offset.nothing") is None
    assert added("1.0\n    if gain > 0.0:\n        raise ValueError", may_make=True) is None


def test_a_loop_that_would_need_numba_to_load_is_left_to_python(added):
    assert added("np.ones(3)[i]", may_make=True) is None


def kept(code, monkeypatch, **names):
    """What a new process keeps under this source, whose file has since changed, adds to one row; None if nothing."""
    monkeypatch.setattr(kept_loop, "_LOADED", {})
    known = {"np": np, **names}
    exec(compile(f"{ADDING}{code}\n    return True\n", __file__, "exec"), known)  # noqa: S102  of the lines above
    rows = np.array([(1.0, 0.0)], ROWS).view(np.recarray)
    found = []
    for may_make in (False, True):
        loop = KeptLoop(known["add_rows"], may_make=may_make)
        found.append(rows.y[0] if loop.run(Parts(record(Offset())), 10.0, rows) else None)
    return found


def test_a_loop_is_that_of_the_code_and_constants_that_run_not_of_their_file(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert kept("1.0", monkeypatch) == [None, 11.0]
    assert kept("2.0", monkeypatch) == [None, 12.0]
    assert kept("1.0", monkeypatch) == [11.0, 11.0]
    for number in (3.0, 4.0):
        assert kept("TABLE[i]", monkeypatch, TABLE=np.array([number])) == [None, 10.0 + number]
        tuned = ModuleType("tuned")
        tuned.K = number
        assert kept("tuned.K", monkeypatch, tuned=tuned) == [None, 10.0 + number]


def test_a_function_of_a_closure_is_left_to_python(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    number = 1.0

    def add_rows(_parts, gain, rows):
        rows[0].y = gain + number
        return True

    rows = np.array([(1.0, 0.0)], ROWS).view(np.recarray)
    assert not KeptLoop(add_rows, may_make=True).run(Parts(record(Offset())), 10.0, rows)


def test_a_damaged_loop_is_made_once_more(added, tmp_path):
    assert added("1.0", may_make=True) is not None
    [file] = (tmp_path / "kept").glob("*.o")
    whole = file.read_bytes()
    for damaged in (whole[:200] + bytes([whole[200] ^ 4]) + whole[201:], whole[:-20], b""):
        file.write_bytes(damaged)
        assert added("1.0") is None
    assert added("1.0", may_make=True) is not None
    assert added("1.0") is not None


def test_a_folder_that_takes_no_file_costs_time_only(added, tmp_path):
    (tmp_path / "kept").write_text("no folder")
    assert added("1.0", may_make=True) is not None
    assert added("1.0") is None


@pytest.mark.long
def test_a_loop_of_the_package_is_made_in_a_process_of_its_own_and_runs_without_numba(tmp_path):
    (tmp_path / "no folder").touch()
    code = """
import sys, warnings
from inteco_abs import run_stop, warm_up
warm_up.WORTH_LOADING = warm_up.WORTH_COMPILING = 0
print(run_stop(out=sys.argv[1]).card['payload_sha256'], "inteco_abs.kept_loop" in sys.modules, "numba" in sys.modules)
"""
    lines = set()
    for name, folder in (("made", "kept"), ("loaded", "kept"), ("made in vain", "no folder")):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / folder)}
        command = [sys.executable, "-P", "-c", code, str(tmp_path / f"{name}.mcap")]
        lines.add(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
    assert len(lines) == 1
    assert lines.pop().split()[1:] == ["True", "False"]
    assert [file.suffix for file in tmp_path.glob("kept/run_ticks*")] == [".o"]
