"""A board family is one record in one folder: nothing else knows one by name, and a package can bring another."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import inteco_abs as product
from inteco_abs.boards import known_families
from inteco_abs.boards.families import SHIPPED
from inteco_abs.config import WIRING, load_config
from inteco_abs.host.attached import host_family
from inteco_abs.mock_board import mock_family

PRODUCT = Path(product.__file__).parent
FOLDER = PRODUCT / "boards" / "families"
PAGE = PRODUCT.parent / "docs" / "how-to" / "add-a-board-family.md"
SECTION = "the section [usb] of a configuration, which has this name in every session"
ALLOWED = {
    "config/model.py": "what a profile that names no family has always meant",
    "commissioning/profile_draft.py": SECTION,
    "commissioning/anonymous_report.py": SECTION,
    "cli/command.py": "a verb that people type for info",
    "commissioning/procedure.py": "the outcome of a step that was not taken",
    "plugins/beside.py": "Python's audit event of a file that is opened",
}


def names_in(file: Path) -> set[str]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)} & SHIPPED.keys()


def test_only_a_familys_own_folder_knows_its_name():
    found = {file.relative_to(PRODUCT).as_posix(): names_in(file) for file in PRODUCT.rglob("*.py")}
    outside = {name for name, names in found.items() if names and not name.startswith("boards/families/")}
    assert outside == ALLOWED.keys()
    for family in SHIPPED:
        others = [name for name, names in found.items() if family in names and f"families/{family}/" not in name]
        assert set(others) <= {*ALLOWED, "boards/families/__init__.py"}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_record_is_complete(name):
    family = known_families()[name]
    assert (family.name, mock_family(name).front_end is not None) == (name, True)
    assert load_config(profile=family.profile).board.kind == load_config(profile=family.mock_profile).board.kind == name
    assert family.address.fullmatch("") is not None
    assert host_family(family).checks
    assert (PRODUCT.parent / family.documentation).is_file()
    assert family.unused_wiring <= set(WIRING)


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """A folder on the path with the package of the how-to page, as pip leaves it."""
    site = tmp_path_factory.mktemp("site")
    for block in re.findall(r"```(?:python|toml)\n# (\S+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        file = site / block[0]
        file.parent.mkdir(exist_ok=True)
        file.write_text(block[1], encoding="utf-8")
    info = site / "toy_board-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-board\nVersion: 1.0\n")
    line = re.search(r"^toy = \"(.*)\"$", (site / "pyproject.toml").read_text(), re.MULTILINE)
    (info / "entry_points.txt").write_text(f"[inteco_abs.board_families]\ntoy = {line[1]}\n")
    return site


def test_another_logic_of_a_family_is_the_pages_profile_and_no_code(toy):
    board = load_config(profile=str(toy / "crane.toml")).board
    assert board.kind in known_families()
    assert (board.logic_version, board.frame_map, board.constants) == (0x0207, "abs", {"pin21": 0})
    assert (board.verified_by, board.evidence["drive_pwm"].status) == ("", "inferred")


@pytest.fixture
def installed(toy):
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(toy), os.environ.get("PYTHONPATH", "")])}


@pytest.fixture
def inteco_abs():
    def run(*arguments, check, environment=None):
        command = [Path(sys.executable).with_name("inteco-abs"), *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == check, done.stderr
        return done

    return run


EXCHANGE = r"""
import json, sys, threading, time
from pathlib import Path
from inteco_abs.boards import check_address, default_profile, known_families, open_board
from inteco_abs.config import WIRING, load_config
from inteco_abs.errors import ConfigError
from inteco_abs.host.attached import found_devices
from inteco_abs.mock_board import Device, SocketServer, front_end_of
from inteco_abs.signals import BoardFlags, Command

address = f"toy:{sys.argv[1]}"
check_address(address)
simulated = Path(default_profile(address))
real = simulated.with_name("real.toml")
real.write_text(simulated.read_text().replace("simulated = true\n", ""))  # as a lab has signed it
config = load_config(profile=str(real))
device = Device(config, time.monotonic_ns)
server, over = SocketServer(front_end_of(device), sys.argv[1]), threading.Event()

def serve():
    while not over.is_set():
        server.step()

thread = threading.Thread(target=serve)
thread.start()
with open_board(address, config, time.monotonic_ns) as board:
    board.exchange(Command(1.0, 0.0))
    time.sleep(0.3)
    sample = board.exchange(Command.SAFE)
over.set()
thread.join()
server.close()
try:
    check_address("toy:")
except ConfigError as error:
    refused = str(error)
print(json.dumps({
    "families": list(known_families()), "road": sample.road_count, "stale": BoardFlags.STALE in sample.board_flags,
    "refused": refused, "duties": device.duties, "found": found_devices(address, config)[0].description,
}))
"""


def test_a_packages_family_is_found_opened_and_exchanged_with(installed, tmp_path):
    arguments = [sys.executable, "-c", EXCHANGE, str(tmp_path / "s")]
    report = json.loads(subprocess.run(arguments, env=installed, capture_output=True, timeout=120, check=True).stdout)
    assert report["families"] == [*SHIPPED, "toy"]
    assert report["road"] > 100
    assert (report["stale"], report["duties"], report["found"]) == (False, [0.0, 0.0], "a socket")
    assert "after toy: comes the path of a socket" in report["refused"]


def test_a_packages_family_runs_a_whole_stop_on_its_mock_board_and_replays(inteco_abs, toy, installed, tmp_path):
    session, profile = tmp_path / "toy.mcap", f"profile={toy / 'toy_board' / 'toy.toml'}"
    settings = ("--set", profile, "--set", "experiment.start_speed_rad_s=20")
    run = inteco_abs("run", "--virtual", "--json", *settings, "--out", session, check=0, environment=installed)
    assert json.loads(run.stdout)["outcome"] == "completed"
    inteco_abs("replay", session, check=0, environment=installed)


def test_without_the_package_its_profile_is_refused_with_the_families_there_are(inteco_abs, toy, tmp_path):
    profile = f"profile={toy / 'toy_board' / 'toy.toml'}"
    run = inteco_abs("run", "--virtual", "--set", profile, "--out", tmp_path / "toy.mcap", check=2)
    assert "no board family 'toy'; known: open, pci, usb, usb2" in run.stderr
    assert not (tmp_path / "toy.mcap").exists()
