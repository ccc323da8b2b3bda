"""The report of a commissioning: what was read from a board, in one file without personal data."""

from __future__ import annotations

import getpass
import os
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import inteco_abs
from inteco_abs.boards import family_of, protocol_name, protocol_of
from inteco_abs.boards.board_report import BoardHeader, BoardReport, Bus, Reads, Values
from inteco_abs.boards.families.usb2.bridge import NOT_REPORTED
from inteco_abs.commissioning.profile_draft import ProfileDraft
from inteco_abs.config import BoardConfig
from inteco_abs.errors import ConfigError
from inteco_abs.host import Computer
from inteco_abs.sessions import host_facts
from inteco_abs.wire import Capture, Record, RecordKind

_SECTIONS: Final = ("board", "encoders", "usb", "loop", "estimator", "guard", "experiment")
_WORDS: Final = frozenset({"kind", "pwm_mode", "application_names", "manufacturer", "engine", "frame_map"})
"""Keys of the profile whose texts come from the program or the board; any other text may be personal."""
_HOST: Final = ("os", "kernel", "machine", "cores", "cpu")
_MOVED: Final = (
    "before the wheels were turned", "after the upper wheel was turned", "after the lower wheel was turned",
)  # fmt: skip
_DATES: Final = ("firmware_compiled", "firmware_released")
_REMOVED: Final = "(removed)"
_SHORTEST: Final = 3
"""Shorter names occur inside too many words."""


def board_seen(draft: ProfileDraft) -> Capture:
    """Report of the steps done so far. Raises ConfigError if the board was not read yet."""
    results, wiring = draft.results, draft.config.board
    header = results.get("header", {})
    if "raw" not in header:
        raise ConfigError.of("--send-report", "the board was not read yet: do step 2, header, first")
    device, reads = _device_facts(draft), results.get("reads", {})
    named = [("header", header["raw"]), *zip(_MOVED, results.get("wheels", {}).get("images", ()), strict=False)]
    report = BoardReport(
        kind=wiring.kind,
        identity=_identity(header),
        bus=_bus(device),
        reads=Reads(count=reads["reads"], failed=reads["failed"], histogram_us=reads.get("histogram_us", {}))
        if "reads" in reads
        else None,
        steps={name: str(one["outcome"]) for name, one in results.items()},
        images=[name for name, _ in named],
        profile={
            name: _values(part, device.get("serial", "")) for name in _SECTIONS if (part := draft.table.get(name))
        },
        computer=_computer(),
    )
    records = [record for at, (_, image) in enumerate(named) for record in _reading(wiring, at, bytes.fromhex(image))]
    made_by = f"inteco-abs {inteco_abs.__version__}, commissioning"
    clock = "none: images in the order in which they were read"
    return Capture(_protocol(wiring), made_by, clock, tuple(records), report=report)


def _protocol(wiring: BoardConfig) -> str:
    """Protocol of the wiring, or for a logic without tables the first one of its family."""
    family = family_of(wiring.kind)
    if not family.protocols:
        return family.name
    with suppress(ConfigError):
        return protocol_name(wiring)
    return family.protocols[0].board


def _reading(wiring: BoardConfig, at: int, image: bytes) -> Iterator[Record]:
    if family_of(wiring.kind).protocols:
        yield Record(float(at), RecordKind.OUT, data=protocol_of(_protocol(wiring)).logic.request)
    yield Record(float(at), RecordKind.IN, data=image)


def _identity(header: Mapping[str, Any]) -> BoardHeader:
    dates = {name: str(header.get("bridge", {}).get(name, NOT_REPORTED)) for name in _DATES}
    return BoardHeader(
        logic_version=int(header["logic_version"], 16),
        application_name=_without_names(str(header["application_name"])),
        synthesis_date=str(header["synthesis_date"]),
        **{name: date for name, date in dates.items() if not date.startswith(NOT_REPORTED)},
    )


def _device_facts(draft: ProfileDraft) -> dict[str, str]:
    """Facts of the listed device that is this board; empty if several could be."""
    listed = draft.results.get("list", {}).get("devices", [])
    serial = draft.results["header"].get("bridge", {}).get("serial", "")
    ours = {draft.board, f"{draft.config.board.kind}:{serial}"}
    found = [one for one in listed if one["address"] in ours] if len(listed) > 1 else listed
    return dict(found[0].get("told", ())) if len(found) == 1 else {}


def _bus(device: Mapping[str, str]) -> Bus:
    serial = device.get("serial", "")
    kept = {name: _masked(text, serial) for name, text in device.items() if name not in {"serial", "descriptors"}}
    form = re.sub(r"[^9]", "x", re.sub(r"\d", "9", serial))
    return Bus(**kept, descriptors=device.get("descriptors", ""), serial_form=form)


def _masked(text: str, serial: str) -> str:
    return _without_names(text.replace(serial, _REMOVED) if serial else text)


def _values(section: Mapping[str, Any], serial: str) -> Values:
    """Numbers of a section, and its texts that are not personal."""
    kept: Values = {}
    for key, value in section.items():
        if isinstance(value, bool | int | float) and key != "verified_logic":
            kept[key] = value
        elif isinstance(value, list) and all(isinstance(one, int) for one in value):
            kept[key] = [*value]
        elif key in _WORDS:
            kept[key] = [_masked(one, serial) for one in value] if isinstance(value, list) else _masked(value, serial)
    return kept


def _computer() -> dict[str, str]:
    host = host_facts()
    system = re.search(r'^PRETTY_NAME="?([^"\n]*)', Computer().text_or("etc/os-release", ""), re.MULTILINE)
    facts: dict[str, str] = {
        **{name: host[name] for name in _HOST if name in host},
        "system": system[1] if system else "",
        "python": platform.python_version(),
        "inteco_abs": inteco_abs.__version__,
    }
    return {name: _without_names(text) for name, text in facts.items() if text}


def _without_names(text: str) -> str:
    """`text` without the names of user, home folder and computer."""
    for name in _names():
        text = re.sub(re.escape(name), _REMOVED, text, flags=re.IGNORECASE)
    return text


def _names() -> list[str]:
    """Longest first, so that no part of one remains."""
    names = {platform.node(), platform.node().partition(".")[0], os.environ.get("HOME", "")}
    with suppress(OSError, KeyError):  # a user without an entry
        names.add(getpass.getuser())
    with suppress(RuntimeError):
        names |= {str(Path.home()), Path.home().name}
    return sorted((name for name in names if len(name) >= _SHORTEST), key=len, reverse=True)
