"""Machine code of functions in several files, kept on disk."""

import importlib
import sys

import pytest

from inteco_abs.montecarlo.kernel import compiled


@pytest.fixture
def result_of(tmp_path, monkeypatch):
    """Compile `outer`, which calls a function of another file, from new: its result, and whether it came from disk."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "outer_file.py").write_text("from inner_file import inner\n\n\ndef outer(x):\n    return inner(x)\n")

    def result(inner):
        (tmp_path / "inner_file.py").write_text(inner)
        for name in ("outer_file", "inner_file"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        function = compiled(importlib.import_module("outer_file").outer)
        return function(2.0), bool(function.stats.cache_hits)

    return result


def test_machine_code_is_kept_until_any_file_that_it_comes_from_changes(result_of):
    assert result_of("def inner(x):\n    return x + 1.0\n") == (3.0, False)
    assert result_of("def inner(x):\n    return x + 1.0\n") == (3.0, True)
    assert result_of("def inner(x):\n    return x + 10.0\n") == (12.0, False)
