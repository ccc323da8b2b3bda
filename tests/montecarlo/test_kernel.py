"""Machine code of functions in several files, kept on disk."""

import importlib
import math
import random
import sys

import numpy as np
import pytest

from inteco_abs import elementary
from inteco_abs.machine_code import compiled


@pytest.fixture
def result_of(tmp_path, monkeypatch):
    """Compile `outer`, which calls a function of another file, from new: its result, and whether it came from disk."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "outer_file.py").write_text("from inner_file import inner\n\n\ndef outer(x):\n    return inner(x)\n")

    def result(inner, x=2.0):
        (tmp_path / "inner_file.py").write_text(inner)
        for name in ("outer_file", "inner_file"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        function = compiled(importlib.import_module("outer_file").outer)
        return function(x), bool(function.stats.cache_hits)

    return result


def test_machine_code_is_kept_until_any_file_that_it_comes_from_changes(result_of):
    assert result_of("def inner(x):\n    return x + 1.0\n") == (3.0, False)
    assert result_of("def inner(x):\n    return x + 1.0\n") == (3.0, True)
    assert result_of("def inner(x):\n    return x + 10.0\n") == (12.0, False)


def test_a_function_that_another_compiled_one_calls_can_be_called_from_python_as_well(result_of):
    """The code that is kept for its caller has no entry for Python: to load that would end the process."""
    result_of("def inner(x):\n    return x + 1.0\n")
    function = compiled(sys.modules["inner_file"].inner)
    assert (function(2.0), bool(function.stats.cache_hits)) == (3.0, False)


def test_machine_code_is_made_again_when_a_constant_of_another_file_changes(result_of, tmp_path, monkeypatch):
    inner = "from constant_file import ADDED\n\ndef inner(x):\n    return x + ADDED\n"
    for added, from_disk in ((1.0, False), (1.0, True), (10.0, False)):
        (tmp_path / "constant_file.py").write_text(f"ADDED = {added}\n")
        monkeypatch.delitem(sys.modules, "constant_file", raising=False)
        assert result_of(inner) == (2.0 + added, from_disk)


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_damaged_machine_code_is_made_once_more(result_of, tmp_path, suffix):
    inner = "def inner(x):\n    return x + 1.0\n"
    result_of(inner)
    [file] = (file for file in tmp_path.rglob(f"*.{suffix}") if "outer" in file.name)
    whole = file.read_bytes()
    for damaged in (whole[:200] + bytes([whole[200] ^ 4]) + whole[201:], whole[:-20], b""):
        file.write_bytes(damaged)
        assert result_of(inner) == (3.0, False)
    assert result_of(inner) == (3.0, True)


def test_two_processes_that_compile_at_once_for_two_types_keep_their_own_code(result_of, tmp_path):
    inner = "def inner(x):\n    return x + 1\n"
    result_of(inner, 2.0)
    indices = {file: file.read_bytes() for file in tmp_path.rglob("*.nbi")}
    for file in indices:
        file.unlink()  # the second process has looked for it before the first wrote it,
    assert result_of(inner, 2) == (3, False)
    for file, content in indices.items():
        file.write_bytes(content)  # which is the last to do so
    assert result_of(inner, 2.5) == (3.5, True)


def test_compiled_functions_of_the_arithmetic_have_the_bits_of_python():
    pick = random.Random(1)
    drawn = [(pick.uniform(-750.0, 750.0), pick.uniform(-30.0, 30.0)) for _ in range(1000)]
    drawn += [(math.ldexp(pick.uniform(-1.0, 1.0), pick.randrange(-1074, 1025)), 2.5) for _ in range(1000)]
    drawn += [(x, 2.5) for x in (0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324)]
    for name, function in elementary.ARITHMETICS[elementary.PORTABLE].items():
        arguments = {"power": lambda x, y: (abs(x), y), "raised": lambda x, _: (x, 4)}.get(name, lambda x, _: (x,))
        for x, y in drawn:
            found, expected = (np.float64(call(*arguments(x, y))) for call in (compiled(function), function))
            assert np.array_equal(found, expected, equal_nan=True)
            assert np.array_equal(np.signbit(found), np.signbit(expected)) or np.isnan(expected).all()
