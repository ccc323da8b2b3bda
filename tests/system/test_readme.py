import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
CAPTURED = {source.name for source in (ROOT / "docs/source").glob("*.md")}
"""Pages whose commands tools/capture_reference runs."""
PAGES = {page: page.read_text(encoding="utf-8") for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]}
READ_ON = "".join(text for page, text in PAGES.items() if page.name not in CAPTURED)
"""README, then the pages to read on in."""
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
FILES = {
    text.split("\n", 1)[0].removeprefix("# "): text
    for kind, text in BLOCK.findall(READ_ON)
    if kind in {"toml", "python"}
}
ENDS = {
    " diff stop.mcap other.mcap": {4},
    " recover cut.mcap": {3},
    " --inject road-stuck": {5},
    " doctor": {0, 3},
    " demo": {0, 3},
    " run --board sim: ": {0, 3},
    " design --uncertain mu=1% --lag ": {3},
}
"""Exit codes of commands that find differences, losses or a limit cycle, or may be late: real time, the doctor."""
CHECK_ITSELF = "./tools/check"  # running it is what runs this test
FEWER = {r"--draws \d\d+": "--draws 3", r":0-49\b": ":0-1", r"--tune\b": "--tune --law PI"}
"""Rigs and laws of which a few do: the figures of the pages are of hundreds, and take half an hour."""


@pytest.fixture
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
    return next((codes for part, codes in ENDS.items() if part in command and not _virtual(part, command)), {0})


def _virtual(part, command):
    """Whether the command is never late, as others that begin so may be."""
    return "--virtual" in command and part == " run --board sim: "


def commands_of(text):
    blocks = (block for kind, block in BLOCK.findall(text) if kind == "console")
    return [line.removeprefix("$ ") for block in blocks for line in block.splitlines()]


COMMAND = "./tools/run "
OTHER_PROCESSES = ("run --board sim: --out real-time.mcap", "demo --no-wait")
"""Commands that other tests run in its place: a run in real time, and a tour of commands that the pages have, too."""


def test_every_command_of_the_readme_runs(main_here, tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "sessions").mkdir()
    for command in commands_of(README):
        arguments = command.removeprefix(COMMAND)
        if arguments in OTHER_PROCESSES or arguments == command:
            continue
        run = main_here(*shlex.split(arguments, comments=True))
        assert run.returncode in ends_of(command), f"{command}\n{run.stdout}{run.stderr}"
    assert (tmp_path / "stop.png").is_file()
    written = {path.name for path in tmp_path.iterdir()} - {"sessions", *FILES}
    ignored = subprocess.run(
        ["git", "check-ignore", "--no-index", "--stdin"],
        cwd=ROOT, input="\n".join(written), capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert set(ignored) == written


@pytest.mark.long
def test_every_command_runs_in_a_fresh_clone(clone, untraced):
    fewer = READ_ON
    for many, few in FEWER.items():
        fewer = re.sub(many, few, fewer)
    for command in commands_of(fewer):
        if command == CHECK_ITSELF:
            continue
        run = subprocess.run(
            ["sh", "-c", command], cwd=clone, env=untraced, capture_output=True, text=True, timeout=1800, check=False
        )
        assert run.returncode in ends_of(command), f"{command}\n{run.stdout}{run.stderr}"
    assert list((clone / "sessions").glob("stop-*.png"))
    assert (clone / "stop.png").is_file()


@pytest.mark.long
def test_a_bundle_installs_without_a_package_index(clone, tmp_path, untraced):
    nowhere = {**untraced, "PIP_INDEX_URL": "http://127.0.0.1:9/simple", "HOME": str(tmp_path)}
    for command, environment in (
        ("./tools/bundle", untraced),
        ("tar -C dist -xf dist/inteco-abs-*.tar && dist/inteco-abs-*/install", nowhere),
        ("~/inteco-abs/bin/inteco-abs run --virtual --seed 1 --out bundled.mcap --json", nowhere),
    ):
        run = subprocess.run(
            ["sh", "-c", command], cwd=clone, env=environment, capture_output=True, text=True, timeout=900, check=False
        )
        assert run.returncode == 0, f"{command}\n{run.stdout}{run.stderr}"
    assert "952fe7cf244d" in run.stdout


@pytest.mark.long
@pytest.mark.untraced
def test_the_figures_in_the_controllers_table_are_those_of_the_program(card):
    page = PAGES[ROOT / "docs/controllers.md"]
    rows = re.findall(
        r"^\| (moving-window|euler|observer) \| ([\w-]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", page, re.MULTILINE
    )
    assert len(rows) == 4
    for number, (estimator, controller, rms, low, stop) in enumerate(rows):
        result = card("--estimator", estimator, "--controller", controller, out=f"{number}.mcap")
        shown = {"slip_rms_fixed_true": rms, "slip_rms_low_speed_true": low, "stop_time_s": stop}
        for name, text in shown.items():
            last_digit = 10.0 ** -len(text.partition(".")[2])
            assert result[name] == pytest.approx(float(text), abs=0.6 * last_digit)


@pytest.mark.parametrize("picture", sorted((ROOT / "tools/images").iterdir()), ids=lambda picture: picture.name)
def test_every_picture_is_one_not_too_large_and_shown(picture):
    data = picture.read_bytes()
    assert data.startswith(b"\x89PNG")
    assert len(data) < 200_000
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert any(f"images/{picture.name})" in page.read_text(encoding="utf-8") for page in pages)
