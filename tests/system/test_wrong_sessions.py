"""Wrong sessions and captures, packages that are not there, and places where nothing can be written."""

import errno
import os
import subprocess

import pytest
from mcap.writer import Writer
from wrong_inputs import Row, file, folder, full_disk, ids, session, without

QUICK = "--virtual --set experiment.start_speed_rad_s=20"


def cut(data):
    return data[: len(data) * 9 // 10]


def flipped(data):
    changed = bytearray(data)
    changed[len(data) // 2] ^= 0x10
    return bytes(changed)


def gone(place):
    """Another program has removed the working folder."""

    def cwd():
        raise FileNotFoundError(errno.ENOENT, "No such file or directory")

    place.patch.chdir(place.folder)  # while there is one
    place.patch.setattr(os, "getcwd", cwd)


def foreign(place):
    """An MCAP file of another program."""
    with (place.folder / "x.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="another")
        writer.finish()


INPUTS = [
    Row("no session", "info missing.mcap", 1, ("missing.mcap", "No such file"), "inteco-abs list . shows"),
    Row("no folder", "replay runs/missing.mcap", 1, ("missing.mcap", "No such file"), "there is no folder runs"),
    Row("no capture", "wire show missing.wire", 1, ("missing.wire", "No such file"), "inteco-abs wire import write"),
    Row("no folder of sessions", "list missing", 1, ("missing", "No such file"), "name a folder with sessions"),
    Row("nearly a session", "info stpo.mcap", 1, ("stpo.mcap", "No such file"), "did you mean stop.mcap?",
        (session(),)),
    Row("a link to nowhere", "info stpo.mcap", 1, ("stpo.mcap", "No such file"), "did you mean stop.mcap?",
        (session(), lambda place: (place.folder / "stpo.mcap").symlink_to("nowhere"))),
    Row("a folder", "info runs", 1, ("runs: cannot be read",), "a folder, which inteco-abs list runs shows",
        (folder("runs"),)),
    Row("an empty file", "info stop.mcap", 1, ("stop.mcap: is not an MCAP file",), "it is empty", (file("stop.mcap"),)),
    Row("a file cut within its first bytes", "info stop.mcap", 1, ("not an MCAP file", "cut off after 5 bytes"),
        "of an MCAP file's first bytes", (file("stop.mcap", b"\x89MCAP"),)),
    Row("text", "replay notes.txt", 1, ("not an MCAP file", "b'just tex', as text does"),
        "give a session that inteco-abs run wrote", (file("notes.txt", "just text\nof two lines\n"),)),
    Row("a ROS bag", "info x.bag", 1, ("is a ROS bag",), "reads only its own sessions", (file("x.bag",
        "#ROSBAG V2.0\n"),)),
    Row("a ROS 2 bag", "info x.db3", 1, ("SQLite",), "only its own sessions", (file("x.db3",
        b"SQLite format 3\0" + bytes(99)),)),
    Row("gzip", "report x.mcap.gz", 1, ("compressed with gzip",), "gunzip", (file("x.mcap.gz",
        b"\x1f\x8b\x08" + bytes(9)),)),
    Row("zstd", "extract x.zst", 1, ("compressed with zstd",), "unzstd",
        (file("x.zst", b"\x28\xb5\x2f\xfd" + bytes(9)),)),
    Row("a zip archive", "diff x.zip x.zip", 1, ("zip archive",), "unpack it first", (file("x.zip",
        b"PK\x03\x04" + bytes(9)),)),
    Row("MATLAB's", "what-if x.mat --controller relay", 1, ("MATLAB file",), "the session that it was exported from",
        (file("x.mat", b"MATLAB 5.0 MAT-file" + bytes(99)),)),
    Row("a ring", "info x.ring", 1, ("the memory of a run",), "inteco-abs recover FILE", (file("x.ring",
        "inteco-abs ring 9\n"),)),
    Row("an MCAP file of others", "info x.mcap", 1, ("is an MCAP file",), "not a session of this program",
        (foreign,)),
    Row("cut", "extract stop.mcap config.toml --out c.toml --json", 3, ("ends early", "ticks are complete"),
        "recover makes a session",
        (session(change=cut),), ("c.toml",), runs=True),
    Row("cut before its first tick", "replay stop.mcap", 1, ("ends early", "0 ticks"), "has no",
        (session(change=lambda data: data[:3000]),)),
    Row("a flipped bit", "replay stop.mcap", 1, ("stop.mcap: is damaged",), "inteco-abs recover saves",
        (session(change=flipped),)),
    Row("a flipped bit in a report", "report stop.mcap", 1, ("is damaged",), "inteco-abs recover saves",
        (session(change=flipped),)),
    Row("a flipped bit in a figure", "figure stop.mcap -o x.png", 1, ("is damaged",), "inteco-abs recover saves",
        (session(change=flipped),)),
    Row("nothing to recover", "recover notes.txt -o x.mcap", 1, ("notes.txt",), "nothing to recover",
        (file("notes.txt", "just text"),)),
    Row("a file to list", "list stop.mcap", 1, ("cannot be listed",), "inteco-abs info stop.mcap", (session(),)),
    Row("no such attachment", "extract stop.mcap rig.toml", 2, ("no attachment 'rig.toml'",),
        "config.toml", (session(),)),
    Row("no name to take out", "extract stop.mcap --out x", 2, ("--out",), "extract FILE NAME --out OUT", (session(),)),
    Row("a session without frames", "wire show stop.mcap", 1, ("stop.mcap",), "--frames", (session(),)),
    Row("text for a capture", "wire changes notes.txt", 1, ("notes.txt",), "captures are JSON lines",
        (file("notes.txt", "just text\n"),)),
    Row("a cut capture", "wire replay x.jsonl", 1, ("x.jsonl",), "the file was cut off", (file("x.jsonl", "{"),)),
    Row("nothing of gold", "golden test", 2, ("golden has no golden session",), "inteco-abs golden add FILE"),
    Row("gold without a reason", "golden add stop.mcap --reason ''", 2, ("--reason",), "why", (session(),)),
    Row("gold that is damaged", "golden add stop.mcap --reason x", 1, ("is damaged",), "inteco-abs recover saves",
        (session(change=flipped),)),
]  # fmt: skip

PACKAGES = [
    Row("figures", "figure stop.mcap -o x.png", 1, ("matplotlib",), "pip install 'inteco-abs[figures]'",
        (session(), without("matplotlib"))),
    Row("a run's figure", f"run {QUICK} --figure x.png", 1, ("matplotlib",), "pip install 'inteco-abs[figures]'",
        (without("matplotlib"),)),
    Row("the paper", "paper", 1, ("matplotlib",), "pip install 'inteco-abs[figures]'", (without("matplotlib"),)),
    Row("reports", "report stop.mcap", 1, ("bokeh",), "pip install 'inteco-abs[report]'", (session(),
        without("bokeh"))),
    Row("Parquet", "export stop.mcap --format parquet", 1, ("pyarrow",), "pip install 'inteco-abs[export]'",
        (session(), without("pyarrow"))),
    Row("MATLAB", "export stop.mcap --format mat", 1, ("scipy",), "pip install 'inteco-abs[export]'",
        (session(), without("scipy"))),
    Row("the panel", "panel", 1, ("textual",), "pip install 'inteco-abs[panel]'", (without("textual"),)),
    Row("a live view", "run --foxglove", 1, ("websockets",), "pip install 'inteco-abs[foxglove]'",
        (without("websockets"),)),
    Row("Wireshark's captures", "wire import x.pcap -o x.jsonl", 1, ("dpkt",), "pip install inteco-abs[capture]",
        (file("x.pcap", b"\xd4\xc3\xb2\xa1" + bytes(20)), without("dpkt"))),
]  # fmt: skip

OUTPUTS = [
    Row("a session that exists", f"run {QUICK} --out stop.mcap", 2, ("--out: stop.mcap: exists already",),
        "choose another name", (file("stop.mcap", "precious"),)),
    Row("no folder for it", "run --virtual --out nowhere/stop.mcap", 2, ("nowhere",), "create it first"),
    Row("a folder in its place", "run --virtual --out runs", 2, ("runs: is a folder",), "name a file in it",
        (folder("runs"),)),
    Row("another kind of name", "run --virtual --out stop.bag", 2, ("stop.bag",), "must end in .mcap"),
    Row("a name beyond all", f"run --virtual --out {'x' * 300}.mcap", 2, ("--out", "File name too long"),
        "choose a shorter name"),
    Row("where no user can write", "run --virtual --out /proc/stop.mcap", 1, ("/proc/stop.mcap", "cannot be created"),
        "name another place"),
    Row("no folder of sessions", "run --virtual", 2, ("sessions cannot be made",), "choose another name",
        (file("sessions"),)),
    Row("a folder that is gone", "run --virtual", 1, ("the current folder no longer",), "change to another", (gone,)),
    Row("a tour in a folder that is gone", "demo", 1, ("the current folder no longer",), "change to another", (gone,)),
    Row("a figure of no format", "run --figure stop.bmp", 2, ("stop.bmp",), ".png"),
    Row("no folder for a figure", "run --figure nowhere/stop.png", 2, ("nowhere",), "create it first"),
    Row("one name for two", "run --virtual --out x.mcap --record-wire x.mcap", 2, ("--record-wire",
        "same file as --out"),
        "choose another name"),
    Row("a report of no format", "report stop.mcap -o x.pdf", 2, ("x.pdf",), "must end in .html", (session(),)),
    Row("a report that exists", "report stop.mcap", 2, ("stop.html: exists already",), "choose another name",
        (session(), file("stop.html"))),
    Row("an export of no format", "export stop.mcap", 2, ("--format: missing",), "csv, npz, mat, parquet",
        (session(),)),
    Row("an export that exists", "export stop.mcap --format csv", 2, ("exists already",), "choose another name",
        (session(), file("stop.csv"))),
    Row("recovered onto itself", "recover stop.mcap -o stop.mcap", 2, ("stop.mcap: exists already",),
        "choose another name",
        (session(),)),
    Row("a series that exists", "repeat 2 --virtual -o series", 2, ("series", "exists already"),
        "name a folder that does not exist",
        (folder("series"),)),
    Row("a tour that exists", "demo -o tour", 2, ("tour", "exists already"), "name a folder that does not exist",
        (folder("tour"),)),
    Row("a plan's folder that is a file", "identify --plan --virtual -o plan", 2, ("plan",), "choose another name",
        (file("plan"),)),
    Row("a paper that is a file", "paper -o x", 2, ("x: is a file",), "name a folder", (file("x"),)),
    Row("a configuration that exists", "config init", 2, ("rig.toml: exists already",), "choose another name",
        (file("rig.toml"),)),
    Row("a layout that exists", "viewer-layout --for lichtblick -o x.json", 2, ("x.json: exists already",),
        "choose another name",
        (file("x.json"),)),
    Row("a draft of no format", "commission --yes-read-only --virtual --draft lab.ini", 2, ("lab.ini",),
        "must end in .toml"),
    Row("no folder for a draft", "commission --yes-read-only --virtual --draft no/lab.toml", 2, ("no/lab.toml",),
        "create it"),
    Row("sessions in a file", "doctor --sessions x", 2, ("x: is a file",), "name a folder", (file("x"),)),
    Row("no folder for a table", "sweep --csv nowhere/x.csv", 2, ("--csv", "nowhere"), "create it first"),
    Row("no folder for the truth", "mock-board --pty --truth no/t.jsonl", 2, ("--truth: no/t.jsonl",),
        "create its folder first"),
    Row("a file at the mock's link", "mock-board --pty notes.txt", 1, ("notes.txt", "no symbolic link"),
        "choose another",
        (file("notes.txt"),)),
]  # fmt: skip

FULL = [
    Row("a stop", f"run {QUICK} --out stop.mcap", 1, ("stop.mcap cannot be written: File too large",
        "rig was not moved"),
        "make room there, or name another place"),
    Row("a stop as by default", f"run {QUICK}", 1, ("File too large", "rig was not moved"), "make room there"),
    Row("a series", f"repeat 2 {QUICK}", 1, ("File too large",), "make room there"),
    Row("a plan", f"identify --plan {QUICK}", 1, ("File too large",), "make room there"),
    Row("an export", "export stop.mcap --format csv", 1, ("File too large",), "make room", (session(),)),
    Row("a figure", "figure stop.mcap -o x.svg", 1, ("x.svg", "File too large"), "make room", (session(),)),
    Row("an attachment", "extract stop.mcap config.toml -o c.toml", 1, ("c.toml", "File too large"), "make room",
        (session(),)),
    Row("a layout", "viewer-layout --for lichtblick -o x.json", 1, ("x.json", "File too large"), "make room"),
    Row("a configuration", "config init", 1, ("rig.toml", "File too large"), "make room"),
    Row("a recovery", "recover stop.mcap -o x.mcap", 1, ("no room", "File too large"), "make room",
        (session(change=cut),)),
    Row("a golden session", "golden add stop.mcap --reason x", 1, ("File too large",), "make room", (session(),)),
    Row("a draft", "commission --yes-read-only --virtual", 1, ("rig-profile.toml", "File too large"), "make room"),
]  # fmt: skip


@pytest.mark.parametrize("row", INPUTS, ids=ids(INPUTS))
def test_a_wrong_file_gets_one_clear_answer(answers, row):
    answers.to(row)


@pytest.mark.parametrize("row", PACKAGES, ids=ids(PACKAGES))
def test_a_missing_package_is_named_with_what_installs_it(answers, row):
    answers.to(row)


@pytest.mark.parametrize("row", OUTPUTS, ids=ids(OUTPUTS))
def test_a_wrong_place_gets_one_clear_answer_and_nothing_is_overwritten(answers, row):
    answers.to(row)


@pytest.mark.parametrize("row", FULL, ids=ids(FULL))
def test_a_disk_that_is_full_gets_one_clear_answer_and_no_half_a_file(answers, whole_stop, row):
    assert whole_stop  # written while there is room
    for prepare in row.given:
        prepare(answers.place)
    with full_disk():
        answers.to(row._replace(given=()))


@pytest.mark.long
def test_a_disk_that_fills_up_during_a_run_is_reported_and_leaves_a_readable_file(
    command_path, inteco_abs, untraced, tmp_path
):
    # a limit on file size is the disk that a test can fill
    run = subprocess.run(
        ["sh", "-c", f"ulimit -f 300; exec {command_path} run --virtual --seed 1 --out stop.mcap"],
        cwd=tmp_path, env=untraced, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert run.returncode == 1
    assert "cannot be written: File too large; make room there" in run.stderr
    assert "Traceback" not in run.stderr
    info = inteco_abs("info", "stop.mcap", check=3)
    assert "ends early" in info.stderr
    assert "ticks are complete" in info.stderr
