"""Where a session comes from: software, host, controller, board. All values are text."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import inteco_abs
from inteco_abs.config import RigConfig


def software_facts() -> dict[str, str]:
    """Versions of everything that decides, and the state of the source tree if there is one."""
    packages = {f"package.{name}": version(name) for name in ("mcap", "numpy", "pydantic")}
    return {
        "version": inteco_abs.__version__,
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()),
        "argv": " ".join(sys.argv),
        **packages,
        **_git_facts(Path(inteco_abs.__file__).parent),
    }


def host_facts() -> dict[str, str]:
    """The computer the loop ran on."""
    return {
        "hostname": platform.node(),
        "os": platform.system(),
        "kernel": platform.release(),
        "kernel_build": platform.version(),
        "machine": platform.machine(),
        "cores": str(os.cpu_count()),
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
    for name, value in gains.items():
        facts[f"gain.{name}"] = repr(float(value))
        facts[f"gain.{name}.hex"] = float(value).hex()
    return facts


def _git_facts(folder: Path) -> dict[str, str]:
    def git(*words: str) -> str | None:
        try:
            answer = subprocess.run(  # noqa: S603  fixed words
                ["git", "-C", str(folder), *words],  # noqa: S607  the user's own git
                capture_output=True,
                text=True,
                check=True,
                timeout=5,
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return answer.stdout.strip()

    tracked = git("ls-files", "--error-unmatch", "__init__.py")
    commit = git("rev-parse", "HEAD") if tracked else None
    if commit is None:
        return {}
    return {"git_commit": commit, "git_dirty": str(bool(git("status", "--porcelain"))).lower()}
