"""What docs/interfaces.md shows runs, and prints what the page says."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs/interfaces.md").read_text(encoding="utf-8")
EXAMPLE = re.compile(
    r"```python\n# (\S+)\n(.*?)```\n\n```console\n\$ \.venv/run/bin/python \1\n```\n\n```\n(.*?)```", re.DOTALL
)
EXAMPLES = {name: (source, printed) for name, source, printed in EXAMPLE.findall(PAGE)}
LEARNING = "learn_to_brake.py"


def printed_by(name, folder):
    (folder / name).write_text(EXAMPLES[name][0], encoding="utf-8")
    done = subprocess.run([sys.executable, name], cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_of_the_page_is_found():
    assert len(EXAMPLES) == PAGE.count("```python")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(each, marks=pytest.mark.long) if each == "slip_model.py" else each
        for each in sorted(EXAMPLES.keys() - {LEARNING})
    ],
)
def test_an_example_prints_what_the_page_says(name, tmp_path):
    assert printed_by(name, tmp_path) == EXAMPLES[name][1]


@pytest.mark.long
def test_policy_learns_and_beats_the_papers_law_on_unseen_rigs(tmp_path):
    before, after, learned, worst, law, laws_worst = map(
        float, re.findall(r"-?\d+\.\d+", printed_by(LEARNING, tmp_path))
    )
    assert before < -20.0 < -5.0 < after
    assert learned < law
    assert worst < laws_worst
    shown = [float(each) for each in re.findall(r"-?\d+\.\d+", EXAMPLES[LEARNING][1])]
    assert [before, after, learned, worst, law, laws_worst] == pytest.approx(shown, rel=0.2)
