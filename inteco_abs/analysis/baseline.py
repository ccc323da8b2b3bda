"""The previous comparable run, as a baseline for a result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, Final

from inteco_abs.analysis.catalogue import session_files
from inteco_abs.analysis.gains import gains_in
from inteco_abs.errors import SessionError
from inteco_abs.sessions import DamagedError, Metadata, read_metadata, stored_card

_SAME: Final = ("controller", "estimator", "board", "rig", "reference_slip")
_SPEED: Final = "start_speed_rad_s"
_SAME_SPEED: Final = 0.01
_COMPLETED: Final = "completed"
_MOST_FILES: Final = 100
"""Reading the metadata of one takes about 1 ms."""


def previous_card(card: Mapping[str, Any]) -> dict[str, Any] | None:
    """Card of the latest comparable session in the folder of this card's session; None without one.

    Its key `differs` says which gains and seed are now others, as "Mk 2.0 -> 5.0"; empty if none.

    Comparable: completed, without injected faults, with the same controller, estimator, board, rig and reference slip,
    and within 1 % the same start speed. Nothing is comparable with a reference slip that changes, as the card lacks it.
    """
    if card["outcome"] != _COMPLETED or card["reference_slip"] is None:
        return None
    mine = Path(card["session"])
    for path in islice(_newest_first(mine), _MOST_FILES):
        metadata = _metadata(path)
        other = None if metadata.get("injected") else stored_card(metadata)
        if other is not None and _comparable(card, other):
            before, now = _choices(metadata), _choices(_metadata(mine))
            changed = [f"{name} {before.get(name, '-')} -> {value}" for name, value in now.items()
                       if before.get(name) != value]  # fmt: skip
            return other | {"session": str(path), "differs": ", ".join(changed)}
    return None


def _comparable(card: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    if other.get("outcome") != _COMPLETED or any(other.get(key) != card.get(key) for key in _SAME):
        return False
    speeds = card.get(_SPEED), other.get(_SPEED)
    known = [speed for speed in speeds if isinstance(speed, int | float)]
    return len(known) == len(speeds) and math.isclose(*known, rel_tol=_SAME_SPEED)


def _newest_first(mine: Path) -> Iterator[Path]:
    """Sessions beside `mine` that were written before it."""
    written: list[tuple[int, Path]] = []
    with suppress(SessionError, OSError):
        mine_ns = mine.stat().st_mtime_ns
        for path in session_files(mine.parent):
            with suppress(OSError):  # gone meanwhile
                written.append((path.stat().st_mtime_ns, path))
        written = [(time_ns, path) for time_ns, path in written if path != mine and time_ns <= mine_ns]
    return (path for _, path in sorted(written, reverse=True))


def _metadata(path: Path) -> Metadata:
    """Metadata of a session; empty if it is none, or damaged."""
    try:
        return read_metadata(path)
    except (SessionError, DamagedError):
        return {}


def _choices(metadata: Metadata) -> dict[str, str]:
    """Gains and seed of a run."""
    return {**gains_in(metadata), "seed": metadata.get("software", {}).get("seed", "")}
