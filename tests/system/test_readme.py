import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, re.DOTALL)
COMMANDS = [line.removeprefix("$ ") for kind, text in BLOCKS if kind == "console" for line in text.splitlines()]
FILES = {text.split("\n", 1)[0].removeprefix("# "): text for kind, text in BLOCKS if kind in {"toml", "python"}}
ENDS = {
    " diff stop.mcap other.mcap": {4},
    " recover cut.mcap": {3},
    " doctor": {0, 3},
    " demo": {0, 3},
    " run --board sim: ": {0, 3},
}
"""Exit codes of commands that find differences or losses, or may be late: a stop in real time, and the doctor."""
CHECK_ITSELF = "./tools/check"  # running it is what runs this test


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """The tracked and new files of this tree in an empty folder, as a fresh clone has them."""
    folder = tmp_path_factory.mktemp("clone")
    names = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    for name in filter(lambda name: (ROOT / name).is_file(), names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def ends_of(command):
    return {0} if "--virtual" in command else next((codes for part, codes in ENDS.items() if part in command), {0})


def test_every_command_of_the_readme_runs(clone, untraced):
    assert CHECK_ITSELF in COMMANDS
    for command in COMMANDS:
        if command == CHECK_ITSELF:
            continue
        run = subprocess.run(
            ["sh", "-c", command], cwd=clone, env=untraced, capture_output=True, text=True, timeout=300, check=False
        )
        assert run.returncode in ends_of(command), f"{command}\n{run.stdout}{run.stderr}"
    assert list((clone / "sessions").glob("stop-*.png"))
    assert (clone / "stop.png").is_file()


@pytest.mark.untraced
def test_the_figures_in_the_readmes_table_are_those_of_the_program(card):
    rows = re.findall(
        r"^\| (moving-window|euler|observer) \| ([\w-]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", README, re.MULTILINE
    )
    assert len(rows) == 4
    for number, (estimator, controller, rms, low, stop) in enumerate(rows):
        result = card("--estimator", estimator, "--controller", controller, out=f"{number}.mcap")
        shown = {"slip_rms_true": rms, "slip_rms_low_speed_true": low, "stop_time_s": stop}
        for name, text in shown.items():
            last_digit = 10.0 ** -len(text.partition(".")[2])
            assert result[name] == pytest.approx(float(text), abs=0.6 * last_digit)


def test_every_link_of_the_readme_leads_somewhere():
    for target in re.findall(r"\]\(([^)]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_picture_is_a_picture():
    assert (ROOT / "tools/images/stop.png").read_bytes().startswith(b"\x89PNG")
