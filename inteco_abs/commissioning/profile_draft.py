"""The profile that the commissioning writes, a TOML file that a run can use at any time, and its results beside it.

Both files are replaced as a whole, so that an interruption leaves the old file or the new one.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any, Final, Self

import tomli_w

from inteco_abs.config import (
    COVERED,
    SIGN_OFF,
    RigConfig,
    Table,
    apply_setting,
    changed_wiring,
    laxer_limits,
    load_config,
    parse_config,
    read_profile,
    unsigned,
    wiring_of,
)
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue, describe_disk

_SCHEMA: Final = 1
_COVERED: Final = tuple(key for key in COVERED if key != "evidence")
"""Keys that a sign-off covers, without evidence, which the steps write: repeating one keeps the sign-off."""
_LOGIC: Final = re.compile(r"^((?:logic_version|verified_logic) = )(\d+)$", re.MULTILINE)
"""Logic versions, which the boards' documents give in hex."""
_HEADING: Final = """\
# Profile of one rig, written by `inteco-abs commission`; your own comments are not kept when it continues.
# To use it: inteco-abs run --board ADDRESS --set profile={name}

"""


class ProfileDraft:
    """A profile draft in `file`, with its results in `results_file`."""

    def __init__(self, file: Path, table: Table, results: dict[str, Any]) -> None:
        self.file = file
        self.results_file = results_of(file)
        self._table = table
        self._results = results

    @classmethod
    def open(cls, file: Path, board: str, profile: str, settings: Sequence[str] = (), *, given: bool = False) -> Self:
        """The draft at `file`, or a new one from `profile`, with `settings` such as `board.drive_pwm=1` in it.

        `given`: the user named the profile, so that a draft made from another one is an error. Writes only what is
        new. Raises ConfigError, or AbsError if the disk refuses.
        """
        if file.suffix != ".toml":
            raise ConfigError.of("--draft", f"{file}: a profile's name must end in .toml")
        if not file.parent.is_dir():
            raise ConfigError.of("--draft", f"{file}: the folder {file.parent} does not exist; create it first")
        if file.exists():
            draft = cls(file, read_profile(str(file)), _read_results(results_of(file)))
            parse_config(tomli_w.dumps(draft._table))
            draft._require_same(board, profile if given else "")
        else:
            draft = cls(file, unsigned(read_profile(profile)), _no_results(board, profile))
        before = draft._table
        draft._table = _with_settings(before, settings)
        if draft._table != before or not file.exists():
            draft._void_sign_off(before)
            draft._save_profile()
            draft._save_results()
        return draft

    @property
    def config(self) -> RigConfig:
        """The configuration that the draft gives now. Raises ConfigError if the file was edited and is wrong."""
        return load_config(profile=str(self.file))

    @property
    def table(self) -> Table:
        """A copy of the draft's sections and keys."""
        return deepcopy(self._table)

    @property
    def board(self) -> str:
        """Address of the board that the draft was begun with."""
        return str(self._results["board"])

    @property
    def profile(self) -> str:
        """The profile that the draft was begun from."""
        return str(self._results["profile"])

    @property
    def results(self) -> Mapping[str, Mapping[str, Any]]:
        """Results by name of the step."""
        steps: dict[str, dict[str, Any]] = self._results["steps"]
        return steps

    def begin_from(self, profile: str) -> None:
        """Begin again from another profile; the sections `usb` and `simulation` stay."""
        kept: Table = {key: self._table[key] for key in ("usb", "simulation") if key in self._table}
        simulated = self._table.get("board", {}).get("simulated", False)
        self._table = {**unsigned(read_profile(profile)), **kept}
        self._table["board"]["simulated"] = simulated
        self._results["profile"] = profile
        self._save_profile()
        self._save_results()

    def write(self, values: Mapping[str, Any]) -> None:
        """Set keys such as `board.drive_pwm`; a sign-off that does not cover them is removed. Raises ConfigError."""
        before, self._table = self._table, deepcopy(self._table)
        for path, value in values.items():
            *sections, key = path.split(".")
            section = self._table
            for part in sections:
                section = section.setdefault(part, {})
            section[key] = value
        if not any(path == "board.verified_by" for path in values):
            self._void_sign_off(before)
        try:
            self._save_profile()
        except ConfigError:
            self._table = before
            raise

    def confirm(self, keys: Iterable[str], source: str) -> None:
        """Mark keys of the wiring as confirmed by `source`."""
        evidence = {"status": "confirmed", "source": source}
        self.write({f"board.evidence.{key}": evidence for key in keys})

    def record(self, step: str, result: Mapping[str, Any]) -> None:
        """Keep the result of a step."""
        self._results["steps"][step] = dict(result)
        self._save_results()

    def wiring(self, keys: Iterable[str]) -> dict[str, Any]:
        """Current values of these keys of the wiring, for a later comparison."""
        stated = wiring_of(self.config.as_table())
        return {key: stated.get(key) for key in keys}

    def _require_same(self, board: str, profile: str) -> None:
        begun = str(self._results["board"] or board)
        if begun.partition(":")[0] != board.partition(":")[0]:
            problem = f"{self.file} was begun with the board {begun}, this is {board}; name another file"
            raise ConfigError.of("--draft", problem)
        if profile and profile != self.profile:
            problem = f"{profile}: {self.file} was begun from {self.profile}; name another draft, or leave this out"
            raise ConfigError.of("--profile", problem)

    def _void_sign_off(self, before: Table) -> None:
        if changed_wiring(before, self._table, _COVERED) or laxer_limits(before, self._table):
            self._table = unsigned(self._table)

    def _save_profile(self) -> None:
        parse_config(tomli_w.dumps(self._table))  # only what a run can use gets into the file
        text = _LOGIC.sub(lambda found: f"{found[1]}0x{int(found[2]):04X}", tomli_w.dumps(self._table))
        _replace(self.file, _HEADING.format(name=self.file.name) + text)

    def _save_results(self) -> None:
        _replace(self.results_file, json.dumps(self._results, indent=2, allow_nan=False) + "\n")


def results_of(file: Path) -> Path:
    """File with the results of the draft at `file`."""
    return file.with_suffix(".results.json")


def _no_results(board: str, profile: str) -> dict[str, Any]:
    return {"schema_version": _SCHEMA, "board": board, "profile": profile, "steps": {}}


def _read_results(file: Path) -> dict[str, Any]:
    old = file.with_name(file.name.replace(".results.", ".probe."))  # an earlier name
    file = old if old.exists() and not file.exists() else file
    problem = f"{file} is not a file of the commissioning; delete it to begin again with the draft as it is"
    try:
        results = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return _no_results("", "unknown")
    except (OSError, ValueError) as error:
        raise ConfigError.of("--draft", f"{problem} ({error})") from error
    whole = isinstance(results, dict) and isinstance(results.get("steps"), dict)
    if not (whole and results.get("schema_version") == _SCHEMA and {"board", "profile"} <= results.keys()):
        raise ConfigError.of("--draft", problem)
    if not all(isinstance(one, dict) and "outcome" in one for one in results["steps"].values()):
        raise ConfigError.of("--draft", problem)
    return dict(results)


def _with_settings(table: Table, settings: Sequence[str]) -> Table:
    table = deepcopy(table)
    mistakes = [mistake for setting in settings for mistake in apply_setting(table, setting)]
    if any(setting.partition("=")[0].strip() in {f"board.{key}" for key in SIGN_OFF} for setting in settings):
        mistakes.append(ConfigIssue("--set", "a draft is signed in the last step of the commissioning"))
    if mistakes:
        raise ConfigError(mistakes)
    return table


def _replace(file: Path, text: str) -> None:
    new = file.with_name(f".{file.name}.new")
    try:
        with new.open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        new.replace(file)
    except OSError as error:
        with suppress(OSError):  # it may not even have been made
            new.unlink()
        raise AbsError(f"{file} cannot be written: {describe_disk(error)}") from error
