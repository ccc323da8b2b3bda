"""What a browser may see and do, and the arguments of `inteco-abs run` for the run that it asks for."""

from __future__ import annotations

import ipaddress
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from inteco_abs.boards import simulated
from inteco_abs.control import REFERENCE, Gain
from inteco_abs.errors import ConfigError, near_match

_ASKED: Final = frozenset({"board", "virtual", "seed", "rig", "controller", "estimator", "gains", "speed", "note"})
_RIG: Final = re.compile(r"[a-z0-9-]+:[0-9]{1,18}")
"""A population that ships; the path of another one is not for a browser to name."""
_LARGEST_SEED: Final = (1 << 63) - 1
_LONGEST_NOTE: Final = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """What a browser may see and do."""

    folder: Path
    """Where its runs are written, and the only folder whose files it gets."""
    boards: tuple[str, ...]
    """Addresses at which it may start runs."""
    controllers: Mapping[str, Sequence[Gain]]
    """Controllers that it may choose, with their gains at the values of `start`."""
    estimators: tuple[str, ...]
    start: Mapping[str, Any]
    """What its form shows at first: controller, reference slip and start speed."""
    arguments: tuple[str, ...] = ()
    """Arguments of `inteco-abs run` that hold for each of its runs."""
    host: str = "127.0.0.1"
    port: int = 0
    token: str = field(repr=False)

    @property
    def local(self) -> bool:
        """Whether only browsers on this computer can connect."""
        return self.host == "localhost" or _is_loopback(self.host)

    def boards_for(self, remote: str | None) -> list[str]:
        """Boards at which the browser at the address `remote` may start runs and change gains.

        Real ones only where the browser is on this computer, whose user sees the rig.
        """
        here = _is_loopback(remote or "")
        return [board for board in self.boards if here or simulated(board)]


def _is_loopback(address: str) -> bool:
    """Whether it is an address that only this computer reaches."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def run_words(asked: Mapping[str, Any], served: Served, boards: Sequence[str]) -> list[str]:
    """Arguments of `inteco-abs run` for what a browser asks for, at one of the `boards`.

    Each word is an option with its value, so that no value can be an option. Raises ConfigError for what is not a
    choice of the browser.
    """
    for key in sorted(asked.keys() - _ASKED):
        raise ConfigError.of(key[:100], f"not a choice here{near_match(key[:100], _ASKED)}")
    board, seed = asked.get("board", "sim:"), asked.get("seed", 0)
    if board not in boards:
        problem = "not a board for this browser: a real one must be allowed where serve is started, with --allow-board"
        raise ConfigError.of("board", f"{board!r:.100}: {problem}, and be run from a browser on that computer")
    if isinstance(seed, bool) or not (isinstance(seed, int) and 0 <= seed <= _LARGEST_SEED):
        raise ConfigError.of("seed", f"{seed!r:.100}: must be a whole number in 0..{_LARGEST_SEED}")
    words = [f"--board={board}", f"--seed={seed}"]
    if asked.get("virtual", False) is True:
        words.append("--virtual")
    return [*words, *_texts(asked), *_law(asked, served), *_speed(asked)]


def _texts(asked: Mapping[str, Any]) -> Iterator[str]:
    rig, note = asked.get("rig") or "", asked.get("note") or ""
    if rig:
        if not (isinstance(rig, str) and _RIG.fullmatch(rig)):
            raise ConfigError.of("rig", f"{rig!r:.100}: must be a population and a seed, as hard:17")
        yield f"--rig={rig}"
    if note:
        if not (isinstance(note, str) and len(note) <= _LONGEST_NOTE):
            raise ConfigError.of("note", f"must be a text of at most {_LONGEST_NOTE} characters")
        yield f"--note={note}"


def _law(asked: Mapping[str, Any], served: Served) -> Iterator[str]:
    """Controller, estimator, reference slip and gains."""
    controller, estimator = asked.get("controller") or served.start["controller"], asked.get("estimator") or ""
    if controller not in [*served.controllers]:
        raise ConfigError.of("controller", f"{controller!r:.100}: not one of those that serve offers")
    yield f"--controller={controller}"
    if estimator not in ["", *served.estimators]:
        raise ConfigError.of("estimator", f"{estimator!r:.100}: not one of those that serve offers")
    if estimator:
        yield f"--estimator={estimator}"
    gains = asked.get("gains", {})
    if not isinstance(gains, dict):
        raise ConfigError.of("gains", "must be an object of names and numbers")
    known = [REFERENCE, *(gain.name for gain in served.controllers[controller])]
    for name, value in gains.items():
        if name not in known:
            raise ConfigError.of("gains", f"{name[:100]!r}: not a gain of {controller}{near_match(name[:100], known)}")
        key = f"controller.{name}" if name == REFERENCE else f"controller.gains.{name}"
        yield f"--set={key}={finite_number(name, value)!r}"


def _speed(asked: Mapping[str, Any]) -> Iterator[str]:
    if asked.get("speed") is not None:
        yield f"--set=experiment.start_speed_rad_s={finite_number('speed', asked['speed'])!r}"


def finite_number(name: str, value: object) -> float:
    """`value` if it is a finite number. Raises ConfigError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError.of(name, f"{value!r:.100}: must be a number")
    return float(value)
