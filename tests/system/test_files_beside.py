"""A controller with modules and files beside it: loaded, kept in the session, restored for a replay."""

import io
import json
import shutil
import sys
import zipfile
from contextlib import suppress

import pytest

from inteco_abs.errors import ConfigError
from inteco_abs.plugins import late_files, load_controller, with_files
from inteco_abs.sessions import read_session
from inteco_abs.source_files import SourceFiles, unpacked

QUICK = ("--virtual", "--set", "experiment.start_speed_rad_s=20")
LAW = """\
import json
from pathlib import Path
import numpy as np
from inteco_abs.signals import BrakeDemand
from my_gains import K
from shared.limits import MOST
TABLE = np.load(Path(__file__).with_name("table.npy"))
class Law:
    gains = internals = ()
    def __init__(self, setup):
        with open(bytes(Path(__file__).parent / "tables" / "duty.json")) as file:
            self.duty = json.load(file)
    def update(self, estimate, dt_s):
        return BrakeDemand(min(self.duty + K * (0.2 - estimate.slip) + float(TABLE[1]), MOST))
"""
NAMES = {"my_gains.py", "shared/__init__.py", "shared/limits.py", "table.npy", "tables/duty.json"}
UNSTEADY = """\
import random, time
from pathlib import Path
from inteco_abs.signals import BrakeDemand
class Random:
    gains = internals = ()
    def __init__(self, setup):
        pass
    def update(self, estimate, dt_s):
        return BrakeDemand(0.5 + 0.1 * random.random())
class Clock(Random):
    def update(self, estimate, dt_s):
        return BrakeDemand(0.5 + 0.1 * (time.perf_counter() % 1.0))
class Late(Random):
    def update(self, estimate, dt_s):
        return BrakeDemand(float(Path(__file__).with_name("duty.txt").read_text()))
"""


def write(folder, law=LAW, k="K = 0.5\n"):
    """The controller with all that it loads, and files that it does not."""
    import numpy as np

    for name in ("shared", "tables"):
        (folder / name).mkdir(parents=True)
    (folder / "law.py").write_text(law)
    (folder / "my_gains.py").write_text(k)
    (folder / "shared" / "__init__.py").touch()
    (folder / "shared" / "limits.py").write_text("MOST = 0.9\n")
    (folder / "tables" / "duty.json").write_text("0.5")
    np.save(folder / "table.npy", np.array([1.0, 0.01]))
    (folder / "other.csv").write_text("not of this controller")
    return folder / "law.py"


def test_what_a_controller_loads_is_kept_and_restored_for_a_replay(main_here, tmp_path):
    write(tmp_path / "mine")
    run = main_here("run", *QUICK, "--controller", "mine/law.py:Law", "--out", "stop.mcap", "--json", check=0)
    assert "replay_problem" not in json.loads(run.stdout)
    assert not list(tmp_path.rglob("__pycache__"))
    kept = read_session(tmp_path / "stop.mcap").attachments
    assert kept["controller.py"] == LAW.encode()
    assert set(unpacked(kept["controller.zip"]).files) == NAMES
    assert zipfile.ZipFile(io.BytesIO(kept["controller.zip"])).namelist()[0] == "law.py"
    (tmp_path / "mine" / "my_gains.py").write_text("K = 0.4\n")
    changed = main_here("replay", "stop.mcap", "--controller", "mine/law.py:Law", check=4)
    assert "the controller's source differs from the session's" in changed.stderr
    shutil.rmtree(tmp_path / "mine")
    assert "none differ" in main_here("replay", "stop.mcap", "--controller", "recorded", check=0).stdout
    refused = main_here("replay", "stop.mcap", check=2).stderr
    assert "name that file to replay it, or recorded to run the code that the session keeps" in refused
    same = main_here("what-if", "stop.mcap", "--controller", "recorded", "--set", "controller.reference_slip=0.2",
                      "--json", check=0)  # fmt: skip
    assert json.loads(same.stdout)["alternatives"][0]["horizon_s"] is None
    nothing = main_here("what-if", "stop.mcap", "--controller", "recorded", check=2)
    assert "nothing to compare" in nothing.stderr


@pytest.mark.long
def test_a_session_without_a_controller_of_a_file_keeps_none(inteco_abs):
    inteco_abs("run", *QUICK, "--out", "stop.mcap", "--quiet", check=0)
    assert (
        "keeps no controller of a file" in inteco_abs("replay", "stop.mcap", "--controller", "recorded", check=2).stderr
    )


@pytest.mark.parametrize("name", ["Random", pytest.param("Clock", marks=pytest.mark.long)])
def test_a_run_whose_decisions_do_not_replay_says_so(main_here, tmp_path, name):
    (tmp_path / "law.py").write_text(UNSTEADY)
    run = main_here("run", *QUICK, "--controller", f"law.py:{name}", "--json", check=0)
    problem = json.loads(run.stdout)["replay_problem"]
    assert problem.startswith("the decisions do not replay: ")
    assert "brake_request; the controller uses a clock, random numbers, or something outside of itself" in problem
    assert f"inteco-abs: {problem}" in run.stderr
    series = main_here("repeat", 1, *QUICK, "--controller", f"law.py:{name}", "-o", "series", check=0)
    assert "stop-1.mcap: the decisions do not replay: " in series.stderr


@pytest.mark.long
def test_a_run_names_a_file_that_is_read_too_late_to_be_kept(inteco_abs, tmp_path):
    (tmp_path / "law.py").write_text(UNSTEADY)
    (tmp_path / "duty.txt").write_text("0.6")
    run = inteco_abs("run", *QUICK, "--controller", "law.py:Late", "--out", "stop.mcap", check=0)
    assert "the controller opened duty.txt while it ran" in run.stderr
    assert "controller.zip" not in read_session(tmp_path / "stop.mcap").attachments
    (tmp_path / "duty.txt").unlink()
    replayed = inteco_abs("replay", "stop.mcap", "--controller", "recorded", check=4)
    assert "failed in the replay: FileNotFoundError: " in replayed.stderr
    assert "duty.txt" in replayed.stderr


def made(path):
    """Class, and its source with what it has loaded, once one was made."""
    kind, source = load_controller(f"{path}:Law")
    kind(None)
    return kind, with_files(f"{path}:Law", source)


def test_each_controller_has_the_modules_of_its_own_folder(tmp_path):
    for number in ("0.25", "0.75"):
        kind, source = made(write(tmp_path / number, k=f"K = {number}\n"))
        assert unpacked(source).files["my_gains.py"] == f"K = {number}\n".encode()
        assert float(number) == sys.modules[kind.__module__].K
    (tmp_path / "0.75" / "my_gains.py").write_text("K = 0.5\n")
    kind, _ = made(tmp_path / "0.75" / "law.py")
    assert sys.modules[kind.__module__].K == 0.5


def test_files_are_restored_where_those_beside_the_file_are_others(tmp_path):
    path = write(tmp_path / "mine")
    _, source = made(path)
    assert source == made(path)[1], "the same bytes"
    path.with_name("my_gains.py").write_text("K = 0.1\n")
    kind, again = load_controller(f"{path}:Law", source)
    assert sys.modules[kind.__module__].K == 0.5
    assert kind(None).duty == 0.5
    assert with_files(f"{path}:Law", again) == source


def test_what_is_opened_later_or_by_others_is_not_the_controllers(tmp_path):
    path = write(tmp_path / "mine")
    kind, source = made(path)
    path.with_name("other.csv").read_text()
    assert with_files(f"{path}:Law", source) == source
    assert late_files() == []
    path.with_name("tables").joinpath("duty.json").rename(tmp_path / "duty.json")
    with pytest.raises(FileNotFoundError):
        kind(None)


def test_files_of_more_than_10_mb_are_refused(tmp_path):
    path = write(tmp_path / "mine")
    path.with_name("table.npy").write_bytes(bytes(10_000_000))
    with pytest.raises(ConfigError, match=r"table\.npy: the files beside .*law\.py make 10\.0 MB .* at most 10 MB"):
        load_controller(f"{path}:Law")


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"../escaped.py": b""}, "leads out of their folder"),
        ({"/escaped.py": b""}, "leads out of their folder"),
        ({"large.bin": bytes(21_000_000)}, "more than 20 MB unpacked"),
    ],
)
def test_files_that_cannot_be_restored_are_refused(tmp_path, files, words):
    source = SourceFiles(LAW.encode(), files).packed("law.py")
    with pytest.raises(ConfigError, match=words):
        load_controller(f"{tmp_path}/law.py:Law", source)
    with pytest.raises(ConfigError, match="cannot be restored"):
        load_controller(f"{tmp_path}/law.py:Law", source[: len(source) // 2])
    assert not list(tmp_path.iterdir())


def test_a_damaged_archive_is_refused_or_has_the_same_source():
    source = SourceFiles(LAW.encode(), {"my_gains.py": b"K = 0.5\n"}).packed("law.py")
    for place in range(4, len(source)):
        damaged = bytearray(source)
        damaged[place] ^= 0x81
        with suppress(ValueError):
            assert unpacked(bytes(damaged)).source == LAW.encode(), place


def test_an_archive_that_another_method_compressed_is_refused():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("law.py", bytes(1_000_000))
    with pytest.raises(ValueError, match="not as a session keeps it"):
        unpacked(buffer.getvalue())
