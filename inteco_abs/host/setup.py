"""Makes what a lab computer needs, and takes it back: files of the system, and users in the group of serial ports.

What was made is kept in a record below the same root, so that undoing removes this and nothing else. A file that is
there and was not written by this program, or has been changed since, is never touched.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from inteco_abs.errors import AbsError, ConfigError, describe_disk
from inteco_abs.host.checks import Computer
from inteco_abs.host.permissions import SystemFile, group_members, needed_files, serial_group

RECORD: Final = "/var/lib/inteco-abs/setup.json"
"""What was made: hashes of files, folders, and memberships."""
_VERSION: Final = 1
_AT_ONCE: Final = (("udevadm", "control", "--reload"), ("udevadm", "trigger"))
"""Commands after a change of the rules, on the running system only."""


class Change(NamedTuple):
    """One thing to make or to take back."""

    name: str
    done: bool
    """Whether nothing is to do."""
    what: str
    """What is done to which file or user, and what for."""
    problem: str = ""
    """Why it cannot be done."""


@dataclass(slots=True)
class _Record:
    """What setup has made below a root."""

    place: Path
    files: dict[str, str]
    """SHA-256 of each file's content, by its path."""
    folders: list[str]
    members: list[tuple[str, str]]
    """User and group."""

    @classmethod
    def read(cls, root: Path) -> _Record:
        """The record below `root`, empty without one. Raises ConfigError if it cannot be used."""
        place = root / RECORD.lstrip("/")
        try:
            kept: dict[str, Any] = json.loads(place.read_text(encoding="utf-8")) if place.exists() else {}
            if kept.get("version", _VERSION) != _VERSION:
                raise ConfigError.of(str(place), "was written by another version of inteco-abs; use that one")
            members = [(str(user), str(group)) for user, group in kept.get("members", ())]
            return cls(place, dict(kept.get("files", {})), list(kept.get("folders", ())), members)
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise ConfigError.of(str(place), f"cannot be used: {error}; what it says was made stays") from error

    def write(self) -> None:
        """Keep the record, or remove it if it is empty."""
        if not (self.files or self.folders or self.members):
            self.place.unlink(missing_ok=True)
            return
        self.place.parent.mkdir(parents=True, exist_ok=True)
        kept = {"version": _VERSION, "files": self.files, "folders": self.folders, "members": self.members}
        _replace(self.place, json.dumps(kept, indent=1) + "\n")


class Setup:
    """What is needed below `root` for these users, and what of it is missing."""

    def __init__(self, root: Path = Path("/"), users: Iterable[str] = (), ftdi_serial: str = "") -> None:
        self._root = root
        self._computer = Computer(root)
        self._record = _Record.read(root)
        self._files = needed_files(self._computer, ftdi_serial)
        self._group = serial_group(self._computer)
        self._users = [user for user in users if user != "root"]  # needs no group

    def changes(self) -> list[Change]:
        """Everything that is needed, done or not; nothing is changed."""
        return [*map(self._file_change, self._files), *map(self._membership, self._users)]

    def apply(self) -> list[str]:
        """Make what is missing; return what is left to do. Raises AbsError, before any change if something is wrong."""
        changes = self.changes()
        _require([change.problem for change in changes])
        missing = {change.name for change in changes if not change.done}
        written = [file for file in self._files if file.name in missing]
        _require_writable(self._root, [*(file.path for file in written), RECORD] if missing else [])
        for file in written:
            self._write(file)
        for user in self._users:
            if user not in group_members(self._computer, self._group):
                self._record.members.append((user, self._group))
                self._record.write()
                _run(self._root, "usermod", "--append", "--groups", self._group, user)
        return _activated(self._root) if written else []

    def _file_change(self, file: SystemFile) -> Change:
        path = self._root / file.path.lstrip("/")
        what = f"write {file.path}: {file.grants}"
        found = _content(path)
        if found == file.text:
            return Change(file.name, done=True, what=f"{file.path} is as needed")
        if found is None:
            return Change(file.name, done=False, what=what)
        if self._record.files.get(file.path) == _sha256(found):
            return Change(file.name, done=False, what=f"{what}; that of an earlier version is replaced")
        problem = "was changed after setup" if file.path in self._record.files else "was not written by setup"
        problem = f"{file.path} {problem}, and is never overwritten: move it away, or merge it by hand"
        return Change(file.name, done=False, what=what, problem=problem)

    def _membership(self, user: str) -> Change:
        if user in group_members(self._computer, self._group):
            return Change(f"group of {user}", done=True, what=f"{user} is in {self._group}")
        known = {line.partition(":")[0] for line in self._computer.text_or("etc/passwd", "").splitlines()}
        problem = "" if user in known else f"{user}: no such user in /etc/passwd; name another with --user"
        return Change(f"group of {user}", done=False, what=f"add {user} to group {self._group}", problem=problem)

    def _write(self, file: SystemFile) -> None:
        path = self._root / file.path.lstrip("/")
        try:
            for folder in (path.parent, self._record.place.parent):
                made = ["/" + each.relative_to(self._root).as_posix() for each in _missing_folders(self._root, folder)]
                self._record.folders += [each for each in made if each not in self._record.folders]
            self._record.files[file.path] = _sha256(file.text)
            self._record.write()  # first: what a crash leaves half made can be taken back
            path.parent.mkdir(parents=True, exist_ok=True)
            _replace(path, file.text)
        except OSError as error:
            raise AbsError(f"{path}: cannot be written: {describe_disk(error)}") from error


class Undo:
    """What setup has made below `root`, to be taken back."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root
        self._record = _Record.read(root)

    def changes(self) -> list[Change]:
        """Everything that would be taken back; nothing is changed."""
        return [*self._file_changes(), *self._memberships()]

    def apply(self) -> list[str]:
        """Take it back; return what is left to do. Raises AbsError, before any change if something is wrong."""
        _require([change.problem for change in self.changes()])
        files = [path for path in self._record.files if self._path(path).exists()]
        _require_writable(self._root, [*files, RECORD] if self.changes() else [])
        for path in list(self._record.files):
            self._path(path).unlink(missing_ok=True)
            del self._record.files[path]
            self._record.write()
        for user, group in list(self._record.members):
            if user in group_members(Computer(self._root), group):
                _run(self._root, "gpasswd", "--delete", user, group)
            self._record.members.remove((user, group))
            self._record.write()
        folders = self._record.folders[::-1]
        self._record.folders = []
        self._record.write()  # which removes it
        for folder in folders:
            _remove_if_empty(self._path(folder))
        return _activated(self._root) if files else []

    def _path(self, path: str) -> Path:
        return self._root / path.lstrip("/")

    def _file_changes(self) -> Iterator[Change]:
        for path, sha256 in self._record.files.items():
            found = _content(self._path(path))
            changed = found is not None and _sha256(found) != sha256
            problem = f"{path} was changed after setup: move it away, then undo again" if changed else ""
            yield Change("file", done=found is None, what=f"remove {path}", problem=problem)

    def _memberships(self) -> Iterator[Change]:
        for user, group in self._record.members:
            done = user not in group_members(Computer(self._root), group)
            yield Change(f"group of {user}", done=done, what=f"remove {user} from group {group}")


def _require(problems: Iterable[str]) -> None:
    found = [problem for problem in problems if problem]
    if found:
        raise AbsError("; ".join([*found, "nothing was changed"]))


def _require_writable(root: Path, paths: Sequence[str]) -> None:
    """Raise AbsError if a file there cannot be written or removed."""
    for path in paths:
        folder = (root / path.lstrip("/")).parent
        while not folder.exists():
            folder = folder.parent
        if not os.access(folder, os.W_OK):
            raise AbsError(f"{folder} is not writable for you: this needs root; nothing was changed")


def _missing_folders(root: Path, folder: Path) -> list[Path]:
    """Folders to be made, the outermost first."""
    found = []
    while folder != root and not folder.exists():
        found.append(folder)
        folder = folder.parent
    return found[::-1]


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _content(path: Path) -> str | None:
    """Text of a file, None if there is none; a link, a folder or what cannot be read has a text that nothing equals."""
    if not os.path.lexists(path):
        return None
    try:
        return path.read_text(encoding="utf-8") if path.is_file() and not path.is_symlink() else "\0"
    except (OSError, UnicodeDecodeError):
        return "\0"


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _replace(path: Path, text: str) -> None:
    """Write a file that all may read, whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    with part.open("x", encoding="utf-8", newline="\n") as file:
        os.fchmod(file.fileno(), 0o644)
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def _run(root: Path, program: str, *arguments: str) -> None:
    """Run a program of shadow-utils on this root. Raises AbsError if it fails."""
    elsewhere = (
        [] if root == Path("/") else [{"usermod": "--prefix", "gpasswd": "--root"}[program], str(root.resolve())]
    )
    try:
        subprocess.run(  # noqa: S603  fixed words, and a user of /etc/passwd
            [_found(program), *elsewhere, *arguments], check=True, capture_output=True, text=True, timeout=60
        )
    except FileNotFoundError as error:
        raise AbsError(f"{program} is missing: {' '.join([program, *arguments])}, by hand, is what is left") from error
    except subprocess.SubprocessError as error:
        said = str(getattr(error, "stderr", "") or error).strip()
        raise AbsError(f"{' '.join([program, *arguments])}: {said}") from error


def _found(program: str) -> str:
    """Path of a program of the system's administrator, which an ordinary user's search path may lack."""
    return shutil.which(program, path=f"{os.environ.get('PATH', '')}{os.pathsep}/usr/sbin{os.pathsep}/sbin") or program


def _activated(root: Path) -> list[str]:
    """Make changed rules hold on the running system; return the commands that failed, which a restart replaces."""
    if root != Path("/"):
        return []
    left = []
    for words in _AT_ONCE:
        try:
            subprocess.run([_found(words[0]), *words[1:]], check=True, capture_output=True, timeout=60)  # noqa: S603  fixed words
        except (OSError, subprocess.SubprocessError):
            left.append(" ".join(words))
    return left
