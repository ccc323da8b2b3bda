"""rig.toml -> RigConfig: reports all mistakes at once.

Order of precedence: a `--set` on the command line, then the file, then the profile, then the defaults. Every session
stores the complete result.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

from inteco_abs.config.model import DEFAULT_PROFILE, RigConfig, Section, Table, bare, key_types, section_of
from inteco_abs.config.sign_off import signs_off, void_by_limits, void_by_wiring
from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.toml_text import NOT_TOML, describe_toml_error, line_of, read_toml

Check = Callable[[Mapping[str, Any]], Iterable[ConfigIssue]]
"""Checks the merged table, wrong values included, for what the sections' ranges cannot express."""
_INDEX: Final = re.compile(r"(\.\d+)+$")
"""Index of a value in a list, at the end of a path."""
_PROFILES: Final = Path(__file__).parents[1] / "profiles"


def profiles() -> list[str]:
    """Names of the shipped profiles."""
    return sorted(file.stem for file in _PROFILES.glob("*.toml"))


def load_config(
    file: Path | None = None,
    settings: Sequence[str] = (),
    checks: Iterable[Check] = (),
    profile: str = DEFAULT_PROFILE,
    follows: Callable[[Table], Table] | None = None,
) -> RigConfig:
    """Configuration from `file` (None: defaults), changed by `settings` such as `guard.brake_limit=0.7`.

    `profile` is used if neither names one; `follows` computes values for missing keys from the merged table. Raises
    ConfigError with all mistakes in the file and settings, and those found by `checks`.
    """
    mistakes: list[ConfigIssue] = []
    table = _read(file) if file is not None else {}
    in_file, over = deepcopy(table), _settings_table(settings)
    for setting in settings:
        mistakes.extend(apply_setting(table, setting))
    name = table.setdefault("profile", profile)
    below = _profile(name, mistakes)
    filed, merged = _merge(below, in_file), _merge(below, table)
    mistakes.extend(
        ConfigIssue(f"board.evidence.{key}", "evidence belongs in a file with its source, not on the command line")
        for key in section_of(section_of(over, "board"), "evidence")
    )
    signed_anew = signs_off(in_file) or signs_off(over)
    if signed_anew and _simulated(merged) and not _simulated(below):
        problem = (
            "true in a signed configuration of a real board: remove it, or choose a mock's profile: --set profile=NAME"
        )
        mistakes.append(ConfigIssue("board.simulated", problem))
    void = _void(below, in_file, filed, over, merged)
    if void and isinstance(merged["board"], dict):
        merged["board"] = {**merged["board"], "read_only": void}
    try:
        return _validate(merged if follows is None else _merge(follows(merged), merged), checks, mistakes)
    except ConfigError as error:
        files = [*([] if file is None else [file]), *([Path(name)] if str(name).endswith(".toml") else [])]
        raise ConfigError([_placed(issue, over, files) for issue in error.mistakes]) from None


def _placed(issue: ConfigIssue, over: Table, files: Iterable[Path]) -> ConfigIssue:
    """The issue with the first file and line that has its key, unless the command line has it."""
    path = _INDEX.sub("", issue.path)
    if path not in _leaves(over):
        for file in files:
            line = line_of(file, path)
            if line is not None:
                return issue._replace(place=f"{file}, line {line}")
    return issue


def origins(file: Path | None = None, settings: Sequence[str] = (), profile: str = DEFAULT_PROFILE) -> dict[str, str]:
    """Origin of each value that is not a default, by dotted key, for `load_config` with the same arguments."""
    table = _read(file) if file is not None else {}
    over = _settings_table(settings)
    name = _merge(table, over).get("profile", profile)
    found = dict.fromkeys(_leaves(_profile(name, [])), f"profile {name}")
    found |= dict.fromkeys(_leaves(table), str(file))
    return found | dict.fromkeys(_leaves(over), "command line")


def _leaves(table: Table, above: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}"


def _settings_table(settings: Sequence[str]) -> Table:
    """The settings as a table, without their mistakes."""
    table: Table = {}
    for setting in settings:
        apply_setting(table, setting)
    return table


def profile_text(name: str) -> str:
    """A shipped profile as it was written, comments included."""
    return (_PROFILES / f"{name}.toml").read_text(encoding="utf-8")


def read_profile(name: str) -> Table:
    """Table of a shipped profile or a .toml file, without defaults. Raises ConfigError if there is none."""
    mistakes: list[ConfigIssue] = []
    table = _profile(name, mistakes)
    if mistakes:
        raise ConfigError(mistakes)
    return table


def parse_config(text: str, checks: Iterable[Check] = ()) -> RigConfig:
    """Configuration as stored in a session of this or an earlier version. Raises ConfigError."""
    try:
        table = _stored(text)
    except NOT_TOML as error:
        raise ConfigError.of("config.toml", f"is not TOML: {describe_toml_error(error, text)}") from error
    return _validate(table, checks, [])


def trusted_config(text: str) -> RigConfig:
    """Configuration that this program just wrote, for the processes of a run.

    It is not checked, which is a hundred times as fast as `parse_config`; use that for any other text.
    """
    return _built(RigConfig, _stored(text))


def _stored(text: str) -> Table:
    """The stored table; what is younger than its session is as it was then, so that it replays."""
    table = tomllib.loads(text)
    guard, estimator, controller = (table.setdefault(name, {}) for name in ("guard", "estimator", "controller"))
    if isinstance(guard, dict):
        guard.setdefault("run_up_factor", None)
    if isinstance(estimator, dict) and "longest_dead_time_s" not in estimator:
        estimator["longest_dead_time_s"] = 0.06
        if isinstance(controller, dict) and controller.get("name") == "predictive-reaching":
            controller["gains"] = {"release_share": 0.0, "swing_band": 0.0} | section_of(controller, "gains")
    return table


_Any = TypeVar("_Any", bound=Section)


def _built(section: type[_Any], table: Table) -> _Any:
    kinds = {key: bare(kind) for key, kind in key_types(section).items()}
    return section(**{key: _value(kinds[key], value) for key, value in table.items()})


def _value(kind: Any, value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if isinstance(kind, type) and issubclass(kind, Section):
        return _built(kind, value)
    return {key: _value(get_args(kind)[1], each) for key, each in value.items()}


def _validate(table: Table, checks: Iterable[Check], mistakes: list[ConfigIssue]) -> RigConfig:
    from inteco_abs.config.validation import validated  # noqa: PLC0415 - loads pydantic, which most processes never use

    config = validated(table, mistakes)
    found = [issue for check in checks for issue in check(table)]
    known = {issue.path for issue in found}  # a check knows a gain's range, the types do not
    mistakes[:] = [*(issue for issue in mistakes if issue.path not in known), *found]
    if config is None or mistakes:
        raise ConfigError(mistakes)
    return config


def _simulated(table: Table) -> bool:
    return section_of(table, "board").get("simulated") is True


def _void(below: Table, in_file: Table, filed: Table, over: Table, merged: Table) -> str:
    """Why the sign-off of a lower layer is void; empty if it is valid, or if the layer above has its own."""
    steps = ((below, in_file, filed), (filed, over, merged))
    void = [
        void_by_wiring(signed, changed)
        for signed, above, changed in steps
        if "verified_by" not in section_of(above, "board")
    ]
    if not any(void) and not section_of(merged, "board").get("read_only") and not signs_off(over):
        void.append(void_by_limits(filed if signs_off(in_file) else below, merged))
    return next(filter(None, reversed(void)), "")


def _read(file: Path) -> Table:
    return read_toml(file, f"inteco-abs config init {file} writes one to begin with")


def apply_setting(table: Table, setting: str) -> list[ConfigIssue]:
    """Put one `key=value` into `table`; the value is TOML or a bare word. Returns its mistakes."""
    key, equals, text = setting.partition("=")
    path = key.strip().split(".")
    if not equals or not all(path) or "\n" in setting:
        return [ConfigIssue(f"--set {setting}", "must look like guard.brake_limit=0.7")]
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    except NOT_TOML as error:
        return [ConfigIssue(key.strip(), f"is not a valid value: {describe_toml_error(error, text)}")]
    for part in path[:-1]:
        inner = table.setdefault(part, {})
        if not isinstance(inner, dict):
            return [ConfigIssue(f"--set {setting}", f"{part} is a value, not a section")]
        table = inner
    table[path[-1]] = value
    return []


def _profile(name: object, mistakes: list[ConfigIssue]) -> Table:
    if isinstance(name, str) and name in profiles():
        return tomllib.loads(profile_text(name))
    if isinstance(name, str) and name.endswith(".toml"):
        return read_toml(
            Path(name), "inteco-abs profiles lists those that ship, inteco-abs commission makes one of a board"
        )
    if not isinstance(name, str):
        return _profile(DEFAULT_PROFILE, mistakes)  # the validation reports the mistake
    mistakes.append(
        ConfigIssue("profile", f"{name!r} is not a shipped profile or a .toml file{near_match(name, profiles())}")
    )
    return _profile(DEFAULT_PROFILE, mistakes)


def _merge(below: Table, above: Table) -> Table:
    merged = dict(below)
    for key, value in above.items():
        inner = merged.get(key)
        merged[key] = _merge(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return merged
