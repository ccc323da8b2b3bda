"""Provenance of a session: software, host, controller. All values are text."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Final

from inteco_abs.config import RigConfig, profile_text, profiles
from inteco_abs.control import CONTROLLERS, ESTIMATORS
from inteco_abs.sessions.fingerprint import arithmetic_facts
from inteco_abs.source_files import zipped
from inteco_abs.version import SOURCE_FOLDER, __version__

_DECIDES: Final = "inteco_abs.control."


def software_facts() -> dict[str, str]:
    """Versions of the program and its packages, its arithmetic, and the state of the source tree if there is one."""
    packages = {f"package.{name}": version(name) for name in ("mcap", "numpy", "pydantic")}
    return {
        "version": __version__,
        "python": platform.python_version(),
        **arithmetic_facts(),
        "argv": " ".join(sys.argv).encode(errors="backslashreplace").decode(),  # file names may be any bytes
        **packages,
        **_git_facts(SOURCE_FOLDER),
    }


def host_facts() -> dict[str, str]:
    """The computer the loop ran on."""
    cpus = "/sys/devices/system/cpu"
    of_linux = {
        "cpu": _cpu_model(),
        "governor": _line(f"{cpus}/cpu0/cpufreq/scaling_governor"),
        "isolated_cpus": _line(f"{cpus}/isolated"),
        "clock_source": _line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
    }
    return {
        "hostname": platform.node(),
        "os": platform.system(),
        "kernel": platform.release(),
        "kernel_build": platform.version(),
        "machine": platform.machine(),
        "cores": str(os.cpu_count()),
        **{name: value for name, value in of_linux.items() if value},
    }


def controller_facts(config: RigConfig, gains: Mapping[str, float], source_sha256: str, package: str) -> dict[str, str]:
    """Controller and estimator with every gain, as decimal and as hex float: the exact bits."""
    facts = {
        "name": config.controller.name,
        "source_sha256": source_sha256,
        "package": package,
        "estimator": config.estimator.name,
        "sample_time_s": repr(config.period_ns / 1e9),
        "reference_slip": repr(config.controller.reference_slip),
    }
    if config.controller.constant_slip is None:
        facts["reference"] = config.controller.reference_text
    for name, value in gains.items():
        facts[f"gain.{name}"] = repr(float(value))
        facts[f"gain.{name}.hex"] = float(value).hex()
    return facts


def shipped_law(config: RigConfig) -> bytes:
    """Zip archive of the modules that decide, empty if neither the configured controller nor the estimator ships.

    These are the modules of both, and all of `inteco_abs.control` that they use.
    """
    estimator = ESTIMATORS.get(config.estimator.name)
    classes = (CONTROLLERS.get(config.controller.name), estimator and estimator.works)
    waiting = [base.__module__ for each in classes if each is not None for base in each.__mro__]
    found = set[str]()
    while waiting:
        name = waiting.pop()
        if name.startswith(_DECIDES) and name not in found:
            found.add(name)
            waiting += [getattr(value, "__module__", None) or "" for value in vars(sys.modules[name]).values()]
    places = sorted(f"{name.replace('.', '/')}.py" for name in found)
    return zipped({place: (SOURCE_FOLDER.parent / place).read_bytes() for place in places}) if places else b""


def profile_source(name: str) -> bytes:
    """Content of a shipped profile or of the user's file; empty if it cannot be read any more."""
    if name in profiles():
        return profile_text(name).encode()
    try:
        return Path(name).read_bytes()
    except OSError:
        return b""


def is_source_tree(folder: Path) -> bool:
    """Whether git tracks the package in `folder`; an installation inside of another repository is not tracked."""
    return _git(folder, "ls-files", "--error-unmatch", "__init__.py") is not None


def git_command(folder: Path, *words: str) -> list[str]:
    """Command line of git in `folder`."""
    return ["git", "-C", str(folder), *words]


def _git(folder: Path, *words: str) -> str | None:
    try:
        answer = subprocess.run(  # noqa: S603  fixed words
            git_command(folder, *words), capture_output=True, text=True, check=True, timeout=5
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()


def _git_facts(folder: Path) -> dict[str, str]:
    # sessions and figures beside the program do not change it
    program = (str(folder), str(folder.with_name("firmware_protocol")))
    status = _git(folder, "status", "--porcelain=v2", "--branch", "--", *program) if is_source_tree(folder) else None
    if status is None:
        return {}
    heads = dict(line.removeprefix("# ").split(" ", 1) for line in status.splitlines() if line.startswith("# "))
    facts = {
        "git_commit": heads.get("branch.oid", ""),
        "git_branch": heads.get("branch.head", ""),
        "git_commit_date": _git(folder, "log", "-1", "--format=%cI") or "",
        "git_dirty": str(any(not line.startswith("# ") for line in status.splitlines())).lower(),
    }
    return {name: value for name, value in facts.items() if value}


def _line(path: str) -> str:
    """Content of a one-line file of the kernel; empty if it cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return ""


def _cpu_model() -> str:
    lines = (line.partition(":") for line in _line("/proc/cpuinfo").splitlines())
    return next((value.strip() for name, _, value in lines if name.strip() == "model name"), "")
