"""Counts of all encoder channels while a wheel is turned by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final, NamedTuple

from firmware_protocol import signed32
from inteco_abs.boards import Board
from inteco_abs.commissioning.operator import Operator
from inteco_abs.commissioning.reading import read_patiently
from inteco_abs.commissioning.rig_access import TURNS, RigAccess
from inteco_abs.errors import CommissioningError

USUAL_COUNTS: Final = (2048, 4096)
"""Per turn: in the paper and on the vendor's rig."""
_CHANNEL: Final = re.compile(r"encoder(\d+)_count")
_LOOK_S: Final = 0.05
_REST_S: Final = 3.0
_WAIT_S: Final = 60.0
_LONGEST_S: Final = 180.0
_BEGUN_COUNTS: Final = 256
_ALSO_MOVED: Final = 0.2
_TO_AND_FRO: Final = 0.9
_NEAR: Final = 0.04
"""Relative error of ten turns by hand."""


class HandTurn(NamedTuple):
    """Counts of one channel during a turn by hand."""

    channel: int
    counts: int
    """Signed counts."""


class Unclear(Exception):  # noqa: N818  not yet an error: the operator may turn again
    """The counts are ambiguous; the text says why and what to do."""


def watch(rig: RigAccess, board: Board, operator: Operator) -> HandTurn:
    """Wait until all channels rest for 3 s; return the one that counted.

    Raises Unclear if the counts are ambiguous, LinkError if the board stops answering, CommissioningError after three
    minutes.
    """
    names = {int(match[1]): name for name in board.survey().values if (match := _CHANNEL.fullmatch(name))}
    before = read_patiently(board, names.values())
    net = dict.fromkeys(names, 0)
    travelled = dict.fromkeys(names, 0)
    started_ns = moved_ns = rig.now_ns()
    while True:
        rig.pause(_LOOK_S)
        counts = read_patiently(board, names.values())
        now_ns = rig.now_ns()
        for channel, name in names.items():
            step = signed32(counts[name] - before[name])
            net[channel] += step
            travelled[channel] += abs(step)
            if step:
                moved_ns = now_ns
        before = counts
        operator.show(_moving(net))
        begun = max(travelled.values()) >= _BEGUN_COUNTS
        if now_ns - moved_ns >= (_REST_S if begun else _WAIT_S) * 1e9:
            return judge(net, travelled)
        if now_ns - started_ns >= _LONGEST_S * 1e9:
            raise CommissioningError(
                f"counters still move after {_LONGEST_S:g} s: is a motor on? Channels {_moving(net)}"
            )


def judge(net: Mapping[int, int], travelled: Mapping[int, int]) -> HandTurn:
    """The channel that counted. Raises Unclear if none or several did, or if one went back and forth."""
    most = max(travelled, key=lambda channel: travelled[channel])
    if travelled[most] < _BEGUN_COUNTS:
        raise Unclear("no encoder channel counted: is the encoders' cable plugged in, and was the wheel turned?")
    others = [
        channel for channel in travelled if channel != most and travelled[channel] > _ALSO_MOVED * travelled[most]
    ]
    if others:
        both = ", ".join(map(str, sorted([most, *others])))
        raise Unclear(f"channels {both} counted together: lift the balance lever, so that only one wheel turns")
    if abs(net[most]) < _TO_AND_FRO * travelled[most]:
        raise Unclear(f"channel {most} counted back and forth: turn the wheel in one direction only")
    return HandTurn(most, net[most])


def counts_per_turn(counts: int, turns: float = TURNS) -> int | None:
    """The usual number of counts per turn within 4 % of `counts / turns`; None if there is none."""
    return next((one for one in USUAL_COUNTS if math.isclose(abs(counts) / turns, one, rel_tol=_NEAR)), None)


def _moving(net: Mapping[int, int]) -> str:
    return ", ".join(f"{channel}: {counts:+d}" for channel, counts in net.items() if counts) or "nothing moves yet"
