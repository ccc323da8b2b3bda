"""The software environment of a run: installed packages, and uncommitted changes of the source tree.

Listing a hundred packages takes 0.1 s, so the recorder does it once a process.
"""

from __future__ import annotations

import base64
import hashlib
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from inteco_abs.sessions.provenance import git_command, is_source_tree
from inteco_abs.version import SOURCE_FOLDER, source_sha256

MOST_DIFF_BYTES: Final = 1_000_000
REQUIREMENTS_NAME: Final = "requirements.txt"
DIFF_NAME: Final = "git.diff"


class Enclosure(NamedTuple):
    """A file for a session's attachments."""

    name: str
    media_type: str
    data: bytes


class Environment(NamedTuple):
    """Files, and facts for the metadata record `software`."""

    files: tuple[Enclosure, ...] = ()
    software: Mapping[str, str] = {}

    def as_note(self) -> dict[str, Any]:
        """Return JSON values for another process."""
        files = [[name, media_type, base64.b64encode(data).decode()] for name, media_type, data in self.files]
        return {"files": files, "software": self.software}

    @classmethod
    def of(cls, note: Mapping[str, Any]) -> Self:
        """Return what another process's `as_note` describes."""
        files = (Enclosure(name, kind, base64.b64decode(data)) for name, kind, data in note["files"])
        return cls(tuple(files), note["software"])


@cache
def current_environment() -> Environment:
    """The environment of this process."""
    packages = installed_packages()
    files = [Enclosure(REQUIREMENTS_NAME, "text/plain", packages)]
    software = {"packages_sha256": hashlib.sha256(packages).hexdigest(), "source_sha256": source_sha256()}
    diff, cut = uncommitted_changes(SOURCE_FOLDER)
    if diff:
        files.append(Enclosure(DIFF_NAME, "text/x-diff", diff))
    if cut:
        software["git_diff"] = f"cut after its first {MOST_DIFF_BYTES} bytes"
    return Environment(tuple(files), software)


def installed_packages() -> bytes:
    """Installed packages and their versions in pip's format."""
    found = {f"{name}\n" for name in map(_named, distributions()) if name}
    return "".join(sorted(found, key=str.lower)).encode()


def _named(package: Distribution) -> str:
    """Name and version; empty for the remains of an uninstalled package, or metadata that cannot be read."""
    try:
        facts = package.metadata  # read and parsed with each look
        name, number = facts["Name"], facts["Version"]
    except (OSError, ValueError, LookupError, AttributeError, TypeError):
        return ""
    return f"{name}=={number}" if name and number else ""


def uncommitted_changes(folder: Path, most_bytes: int = MOST_DIFF_BYTES) -> tuple[bytes, bool]:
    """Diff of the source tree around `folder` to its commit, and whether it was cut at `most_bytes`.

    Empty without a source tree, git or changes.
    """
    if not is_source_tree(folder):
        return b"", False
    command = git_command(folder, "diff", "--no-ext-diff", "--no-textconv", "HEAD")
    try:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as git:  # noqa: S603  fixed
            diff = git.stdout.read(most_bytes + 1) if git.stdout else b""
            git.kill()  # the rest is not needed
    except OSError:  # recording must work even if no process can be started
        return b"", False
    return diff[:most_bytes], len(diff) > most_bytes
