import subprocess

import pytest

CASES = [
    (["bogus"], 2, ["bogus", "run"]),
    (["rum"], 2, ["did you mean run"]),
    (["run", "--bord", "sim:"], 2, ["--bord", "--board"]),
    (["run", "--board", "usb3:"], 2, ["usb3:", "sim:"]),
    (["blink", "--board", "pci:"], 2, ["pci:", "usb2:123"]),
    (["blink", "--board", "usb2:5"], 1, ["USB2", "serial number 5"]),
    (["run", "--virtual", "--out", "x.mcap", "--record-wire", "x.mcap"], 2, ["--record-wire", "x.mcap", "--out"]),
    (["run", "--board", "usb2:A1"], 2, ["usb2:A1", "decimal serial number"]),
    (["run", "--board", "usb2:7", "--virtual"], 2, ["usb2:7", "real board"]),
    (["run", "--board", "sim"], 2, ["'sim'", "sim:"]),
    (["run", "--board", "sim:extra"], 2, ["nothing may follow"]),
    (["run", "--board", ""], 2, ["--board"]),
    (["run", "--seed", "one"], 2, ["--seed", "one"]),
    (["run", "--virtual", "--rig", "hrd:17"], 2, ["simulation.rig", "'hrd:17'", "did you mean hard?"]),
    (["run", "--rig", "hard:x"], 2, ["simulation.rig", "'hard:x'", "0..2^64-1", "hard:17"]),
    (["run", "--rig", "hard:17", "--board", "usb2:"], 2, ["--rig", "usb2:", "real board"]),
    (["run", "--rig", "hard:1", "--set", "encoders.counts_per_turn=4096"], 2, ["4096", "set this to 2048"]),
    (["run", "--controller", "reachin-law"], 2, ["did you mean reaching-law"]),
    (["run", "--controller", "quantum"], 2, ["quantum", "reaching-law", "relay"]),
    (["run", "--controller", "missing.py:Law"], 2, ["missing.py", "No such file"]),
    (["run", "--estimator", "eular"], 2, ["did you mean euler"]),
    (["run", "--set", "guard.brake_limt=0.7"], 2, ["guard.brake_limt", "did you mean brake_limit"]),
    (["run", "--set", "guard.brake_limit=1.7"], 2, ["guard.brake_limit", "1.7", "at most 1"]),
    (["run", "--set", "guard.brake_limit=0,7"], 2, ["guard.brake_limit", "0,7", "a number"]),
    (["run", "--set", "guard.over_speed_rad_s=1000"], 2, ["1000", "at most 245"]),
    (["run", "--set", "experiment.start_speed_rad_s=nan"], 2, ["experiment.start_speed_rad_s", "nan"]),
    (["run", "--set", "experiment.start_speed_rad_s=1800rpm"], 2, ["1800rpm", "a number"]),
    (["run", "--set", "controller.gains.Mx=1"], 2, ["controller.gains.Mx", "Mk, Mq"]),
    (["run", "--set", "controller.gains.Mk=-1"], 2, ["Mk", "-1", "0..1000 1/s"]),
    (["run", "--set", "nonsense"], 2, ["nonsense", "guard.brake_limit=0.7"]),
    (["run", "--set", "profile=usb3"], 2, ["usb3", "usb2_generic_0103"]),
    (["run", "--config", "missing.toml"], 2, ["missing.toml", "No such file"]),
    (["run", "--out", "nowhere/stop.mcap"], 2, ["nowhere", "does not exist"]),
    (["run", "--out", "."], 2, ["is a folder"]),
    (["run", "--out", "/proc/stop.mcap"], 1, ["/proc/stop.mcap", "cannot be created"]),
    (["run", "--figure", "stop.bmp"], 2, ["stop.bmp", ".png"]),
    (["run", "--figure", "nowhere/stop.png"], 2, ["nowhere", "does not exist"]),
    (["replay", "missing.mcap"], 1, ["missing.mcap", "No such file"]),
    (["replay"], 2, ["FILE"]),
    (["info", "."], 1, ["cannot be read"]),
    (["info", "notes.txt"], 1, ["no MCAP file"]),
    (["info", "empty.mcap"], 1, ["is empty"]),
    (["list", "missing"], 1, ["missing", "No such file"]),
    (["recover", "missing.mcap", "-o", "x.mcap"], 1, ["missing.mcap", "No such file"]),
    (["recover", "notes.txt", "-o", "x.mcap"], 1, ["notes.txt", "nothing to recover"]),
    (["export", "notes.txt", "--format", "xls"], 2, ["xls", "csv"]),
    (["get", "notes.txt", "config.toml"], 1, ["no MCAP file"]),
    (["diff", "notes.txt"], 2, ["B"]),
    (["figure", "notes.txt", "-o", "x.png"], 1, ["no MCAP file"]),
    (["figure", "notes.txt", "-o", "x.png", "--width", "3"], 2, ["'3'", "'one', 'two'"]),
    (["report", "notes.txt"], 1, ["no MCAP file"]),
    (["report", "notes.txt", "-o", "x.pdf"], 2, ["x.pdf", "must end in .html"]),
    (["report", "notes.txt", "-o", "nowhere/x.html"], 2, ["nowhere", "create it first"]),
    (["run", "--virtual", "--set", "profile=usb2_generic_0103"], 1, ["reading only", "verified_by"]),
]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    CASES,
    ids=lambda value: " ".join(map(str, value))[:60] if isinstance(value, list) else None,
)
def test_wrong_input_gets_one_clear_answer(main_here, tmp_path, arguments, code, words):
    (tmp_path / "notes.txt").write_text("just text")
    (tmp_path / "empty.mcap").write_bytes(b"")
    before = set(tmp_path.iterdir())
    run = main_here(*arguments)
    assert run.returncode == code, run.stderr
    for word in words:
        assert word in run.stderr
    assert len(run.stderr.splitlines()) <= 24
    assert run.stdout == ""
    assert {path for path in tmp_path.iterdir() if path.name != "sessions"} == before
    assert not list(tmp_path.glob("sessions/*"))


@pytest.mark.parametrize("place", [1, 5, 18, 47])
def test_the_installed_command_answers_and_ends_likewise(inteco_abs, main_here, tmp_path, place):
    (tmp_path / "notes.txt").write_text("just text")
    arguments, code, _ = CASES[place]
    run = inteco_abs(*arguments, check=code)
    here = main_here(*arguments)
    assert (run.stdout, run.stderr) == (here.stdout, here.stderr)


def test_five_mistakes_are_all_reported_at_once(main_here, tmp_path):
    (tmp_path / "rig.toml").write_text(
        """
        colour = "red"
        [guard]
        brake_limit = 1.5
        [experiment]
        start_speed_rad_s = "180"
        stop_speed = 0.5
        [controller]
        name = "reaching-lw"
        """
    )
    run = main_here("run", "--config", "rig.toml")
    assert run.returncode == 2
    for path in (
        "colour",
        "guard.brake_limit",
        "experiment.start_speed_rad_s",
        "experiment.stop_speed",
        "controller.name",
    ):
        assert f"{path}: " in run.stderr
    assert "5 mistakes" in run.stderr


def test_an_existing_session_is_never_overwritten(main_here, tmp_path):
    (tmp_path / "stop.mcap").write_bytes(b"precious")
    run = main_here("run", "--virtual", "--out", "stop.mcap")
    assert run.returncode == 2
    assert "exists already" in run.stderr
    assert (tmp_path / "stop.mcap").read_bytes() == b"precious"


@pytest.mark.parametrize("verb", ["info", "replay"])
def test_a_truncated_session_says_so_and_a_flipped_bit_is_found(main_here, tmp_path, verb):
    quick = ("--set", "experiment.start_speed_rad_s=20", "--seed", "1")
    assert main_here("run", "--virtual", *quick, "--out", "stop.mcap").returncode == 0
    data = (tmp_path / "stop.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    run = main_here(verb, "cut.mcap")
    assert run.returncode in (1, 3)
    assert "ends early" in run.stderr or "no ticks" in run.stderr
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 0x10
    (tmp_path / "flipped.mcap").write_bytes(flipped)
    run = main_here(verb, "flipped.mcap")
    assert run.returncode == 1
    assert "damaged" in run.stderr


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("class Law:\n    pass\n", ["no method update"]),
        ("class Law:\n    def update(self, e, dt): ...\n", ["gains must be a tuple"]),
        ("class Lab: pass\n", ["no class 'Law'", "did you mean Lab"]),
        ("import nonexistent_module\n", ["ModuleNotFoundError"]),
        ("def broken(:\n", ["SyntaxError"]),
        (
            "class Law:\n    gains = internals = ()\n    def update(self, e, dt): ...\n",
            ["cannot be made", "takes no arguments"],
        ),
    ],
)
def test_a_file_that_holds_no_controller_is_explained(main_here, tmp_path, source, words):
    (tmp_path / "law.py").write_text(source)
    run = main_here("run", "--virtual", "--controller", "law.py:Law")
    assert run.returncode == 2
    for word in words:
        assert word in run.stderr


def test_a_controller_that_raises_ends_in_a_safety_stop(inteco_abs, tmp_path):
    (tmp_path / "law.py").write_text(
        "class Law:\n"
        "    gains = ()\n"
        "    internals = ()\n"
        "    def __init__(self, setup): self.calls = 0\n"
        "    def update(self, estimate, dt_s):\n"
        "        raise ZeroDivisionError('my own mistake')\n"
    )
    run = inteco_abs("run", "--virtual", "--controller", "law.py:Law", "--out", "stop.mcap")
    assert run.returncode == 5
    assert "my own mistake" in run.stderr
    assert "law.py, line 6" in run.stderr
    assert inteco_abs("info", "stop.mcap").returncode == 0


def test_a_full_disk_ends_the_run_with_a_clear_error_and_a_readable_file(command_path, inteco_abs, untraced, tmp_path):
    # a limit on file size is the disk that a test can fill
    run = subprocess.run(
        ["sh", "-c", f"ulimit -f 300; exec {command_path} run --virtual --seed 1 --out stop.mcap"],
        cwd=tmp_path, env=untraced, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert run.returncode == 1
    assert "cannot be written: File too large" in run.stderr
    assert "Traceback" not in run.stderr
    info = inteco_abs("info", "stop.mcap", check=3)
    assert "ends early" in info.stderr
    assert "ticks are whole" in info.stderr
