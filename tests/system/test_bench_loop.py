import json
import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SCRIPT = Path(__file__).parents[2] / "tools" / "bench_loop"
ROWS = ("C, sleeps", "C, spins too", "our loop alone", "our loop as shipped", "threads instead", "shipped, slow disk")
STAGES = ("exchange", "estimate", "decide", "guard", "make the tick", "pack", "loop", "whole tick", "floor")


def bench(environment, *arguments):
    process = subprocess.run(
        [sys.executable, SCRIPT, "1", "0.5", *arguments],
        env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_every_row_is_printed_with_finite_numbers(untraced):
    text = bench(untraced)
    for name in ROWS if "no C compiler" not in text else ROWS[2:]:
        numbers = re.search(rf"^{name} +(.*)$", text, re.MULTILINE).group(1).split()
        assert len(numbers) == 9
        assert all(word == "-" or math.isfinite(float(word)) for word in numbers)
    for name in STAGES:
        numbers = re.search(rf"^{name}.*?((?: +-?[\d.]+){{3}})$", text, re.MULTILINE).group(1).split()
        assert all(math.isfinite(float(word)) for word in numbers)
    assert "threads against as shipped" in text
    assert "settings refused: " in text
    assert "nan" not in text


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_without_a_compiler_there_are_no_ratios_to_c(untraced, tmp_path):
    report = json.loads(bench({**untraced, "PATH": str(tmp_path)}, "--json"))
    assert "no C compiler" in report["without_c"]
    assert tuple(report["rows"]) == ROWS[2:]
    for row in report["rows"].values():
        assert "to_c" not in row
        assert row["ticks"] > 0
        assert all(
            math.isfinite(row[key])
            for key in ("p50", "p99", "p999", "max", "missed_percent", "round_p999", "wake_up_p999")
        )
    assert all(math.isfinite(value) for column in report["tick_us"].values() for value in column.values())
