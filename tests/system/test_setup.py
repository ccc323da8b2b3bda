"""What setup makes below a root, takes back exactly, and never touches."""

import os
from pathlib import Path

import pytest

from inteco_abs.errors import AbsError
from inteco_abs.host import Setup, Undo, setup
from inteco_abs.host.checks import Computer
from inteco_abs.host.permissions import CHECKS, LIMITS_FILE, UDEV_FILE, udev_rules

USERS = "root:x:0:0::/root:/bin/sh\nlab:x:1000:1000::/home/lab:/bin/sh\n"
GROUP = "root:x:0:\ndialout:x:20:other\nlab:x:1000:\n"
USERMOD = """#!/bin/sh
# --prefix ROOT --append --groups GROUP USER
sed -i "s/^\\($5:.*\\)$/\\1,$6/" "$2/etc/group"
"""
GPASSWD = """#!/bin/sh
# --root ROOT --delete USER GROUP
sed -i "s/^\\($5:.*\\),$4$/\\1/" "$2/etc/group"
"""


@pytest.fixture
def root(tmp_path, monkeypatch):
    """Root of a computer, and programs that change its groups, which only root may."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, text in (("usermod", USERMOD), ("gpasswd", GPASSWD)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "root" / "etc" / "udev").mkdir(parents=True)
    (tmp_path / "root" / "sys").mkdir()
    (tmp_path / "root" / "etc" / "passwd").write_text(USERS)
    (tmp_path / "root" / "etc" / "group").write_text(GROUP)
    return tmp_path / "root"


def below(root):
    return {path.relative_to(root): path.read_bytes() if path.is_file() else None for path in root.rglob("*")}


def at(root, path):
    return root / path.lstrip("/")


def test_undo_restores_exactly_what_was_there(root):
    before = below(root)
    assert [change.done for change in Setup(root, ["lab"]).changes()] == [False] * 3
    assert below(root) == before
    Setup(root, ["lab"]).apply()
    assert "dialout:x:20:other,lab\n" in (root / "etc" / "group").read_text()
    assert at(root, UDEV_FILE).stat().st_mode & 0o777 == 0o644
    assert [change.done for change in Setup(root, ["lab"]).changes()] == [True] * 3
    made = below(root)
    Setup(root, ["lab"]).apply()
    assert below(root) == made
    Undo(root).apply()
    assert below(root) == before


def test_doctor_and_setup_need_the_same_rules(root):
    assert CHECKS["udev rules"](Computer(root)).verdict == "amber"
    Setup(root).apply()
    assert CHECKS["udev rules"](Computer(root)).verdict == "green"


@pytest.mark.parametrize("file", [UDEV_FILE, LIMITS_FILE])
@pytest.mark.parametrize("kind", ["of another", "a link", "changed since", "a folder"])
def test_what_setup_has_not_written_is_never_touched(root, file, kind):
    path = at(root, file)
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "changed since":
        Setup(root).apply()
        path.write_text(path.read_text() + "# mine\n")
    elif kind == "of another":
        path.write_text("# theirs\n")
    elif kind == "a folder":
        path.mkdir()
    else:
        path.symlink_to(root / "etc" / "passwd")
    before = below(root)
    with pytest.raises(AbsError, match="nothing was changed"):
        Setup(root, ["lab"]).apply()
    if kind == "changed since":
        with pytest.raises(AbsError, match="was changed after setup"):
            Undo(root).apply()
    else:
        assert Undo(root).apply() == []
    assert below(root) == before


def test_rules_that_were_installed_by_hand_stay(root):
    at(root, UDEV_FILE).parent.mkdir()
    at(root, UDEV_FILE).write_text(udev_rules("dialout"))
    before = below(root)
    Setup(root).apply()
    Undo(root).apply()
    assert below(root) == before


def test_another_chip_replaces_its_own_rules_and_the_serial_stays(root):
    Setup(root, ftdi_serial="A1").apply()
    assert all(change.done for change in Setup(root).changes())
    Setup(root, ftdi_serial="B2").apply()
    assert 'ATTR{serial}=="B2"' in at(root, UDEV_FILE).read_text()


def test_users_that_are_there_need_nothing_and_others_are_named(root):
    Setup(root, ["root", "other"]).apply()
    assert (root / "etc" / "group").read_text() == GROUP
    with pytest.raises(AbsError, match="nemo: no such user"):
        Setup(root, ["nemo"]).apply()


def test_a_crash_between_record_and_file_can_be_undone(root, monkeypatch):
    before, replace = below(root), setup._replace  # no public name has this moment

    def crash(path, text):
        if path.suffix == ".conf":
            raise KeyboardInterrupt
        replace(path, text)

    monkeypatch.setattr(setup, "_replace", crash)
    with pytest.raises(KeyboardInterrupt):
        Setup(root, ["lab"]).apply()
    monkeypatch.undo()
    Undo(root).apply()
    assert below(root) == before


def test_without_permission_nothing_is_changed(root, monkeypatch):
    before = below(root)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(AbsError, match="needs root"):
        Setup(root, ["lab"]).apply()
    assert below(root) == before


@pytest.mark.parametrize("text", ["no JSON", '{"version": 9}', '{"members": 3}', "[]"])
def test_a_record_that_cannot_be_read_stops_all(root, text):
    at(root, setup.RECORD).parent.mkdir(parents=True)
    at(root, setup.RECORD).write_text(text)
    for make in (Setup, Undo):
        with pytest.raises(AbsError, match=r"setup\.json"):
            make(root)


def test_the_verb_lists_then_makes_then_undoes(root, main_here):
    words = ("setup", "--root", str(root))
    listed = main_here(*words, "--user", "lab", check=3)
    assert "to do  udev rules" in listed.stdout
    assert "nothing was changed" in listed.stderr
    made = main_here(*words, "--user", "lab", "--apply", check=0)
    assert "done   group of lab" in made.stdout
    assert main_here(*words, "--user", "lab", "--json", check=0).stdout.count('"done": true') == 3
    assert "remove /etc/udev" in main_here(*words, "--undo", check=3).stdout
    main_here(*words, "--undo", "--apply", check=0)
    assert "nothing that setup has made is left" in main_here(*words, "--undo", check=0).stdout
    assert not Path(at(root, UDEV_FILE)).exists()
