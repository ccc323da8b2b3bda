"""Explains the keys of rig.toml, writes a template of the file, and shows the origin of values."""

from __future__ import annotations

import difflib
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from datetime import date
from typing import Any, Final, NamedTuple

import tomli_w

from inteco_abs.config.model import RigConfig, Section, defaults, key_types, limits
from inteco_abs.config.validation import meanings
from inteco_abs.errors import ConfigError, near_match

_WIDTH: Final = 100
_GAINS: Final = "controller.gains"
_HEADER: Final = """\
Configuration of a rig. Every key is optional: what is commented out here is the default. `inteco-abs config show`
prints the resulting values, and `inteco-abs config explain KEY` explains a key.
"""
_PROFILES: Final = "The section [board] comes with the profile; `inteco-abs profiles` lists them, and prints one."


Controllers = Mapping[str, Any]
"""Controllers by name, each with `gains` as in `Controller`."""


class ConfigKey(NamedTuple):
    """One key of the configuration."""

    path: str
    """Dotted key, as for --set."""
    kind: str
    """Type and range as text."""
    default: Any
    """Default value; None without one."""
    meaning: str
    of: str = ""
    """Controller of a gain; several controllers have gains of one name."""


def all_keys(controllers: Controllers) -> list[ConfigKey]:
    """Every key of rig.toml by section, with the gains of all controllers."""
    found = list(_keys(RigConfig, ()))
    place = next(i for i, key in enumerate(found) if key.path == _GAINS)
    return found[: place + 1] + list(_gains(controllers)) + found[place + 1 :]


def explain(path: str, below: Mapping[str, Any], controllers: Controllers) -> str:
    """A key's meaning, or a line for each key of a section; `below` has the profile's values.

    Raises ConfigError for an unknown key.
    """
    mine, within = _asked(path, controllers)
    if within:
        return "\n".join(_in_short(key) for key in mine + within)
    return "\n\n".join(_in_full(key, below) for key in mine)


def facts(path: str, below: Mapping[str, Any], controllers: Controllers) -> list[dict[str, Any]]:
    """Return path, type and range, default, value of the profile, and meaning of each key, as data."""
    mine, within = _asked(path, controllers)
    return [
        {
            "path": key.path,
            "kind": key.kind,
            "default": key.default,
            "profile": str(value) if isinstance(value := _value_in(below, key.path), date) else value,
            "meaning": key.meaning,
        }
        for key in mine + within
    ]


def _asked(path: str, controllers: Controllers) -> tuple[list[ConfigKey], list[ConfigKey]]:
    """Keys of that path, and keys within it. Raises ConfigError if there are none."""
    keys = all_keys(controllers)
    asked = path.strip().strip(".[]")
    mine = [key for key in keys if key.path == asked]
    within = [key for key in keys if key.path.startswith(f"{asked}.")]
    if mine or within:
        return mine, within
    raise ConfigError.of(path or "KEY", f"is not a key of rig.toml{_hint(asked, keys)}")


def _hint(asked: str, keys: Iterable[ConfigKey]) -> str:
    """Keys with this last part, else a similar one, else the sections."""
    paths = dict.fromkeys(key.path for key in keys)
    sections = dict.fromkeys(section for path in paths if (section := path.rpartition(".")[0]))
    tails = [path for path in paths if path.rpartition(".")[2] == asked]
    if tails:
        return f"; did you mean {' or '.join(tails)}?"
    known = [*paths, *sections]
    near = difflib.get_close_matches(asked, known, n=1)
    return near_match(asked, known if near else {path.partition(".")[0] for path in paths})


def template(controllers: Controllers) -> str:
    """A rig.toml with every section and key, its meaning above it and its default commented out."""
    lines = [*(f"# {line}" for line in _HEADER.splitlines()), ""]
    section = ""
    for key in all_keys(controllers):
        above, _, name = key.path.rpartition(".")
        if above in ("board", "board.evidence", _GAINS):
            continue
        if above != section:
            lines.append(f"[{above}]")
            section = above
        lines += [f"# {line}" for line in (*_wrapped(key.meaning), key.kind)]
        lines += [f"# {name} = {_toml(key.default)}" if key.default is not None else f"# {name} =", ""]
    return "\n".join([*lines, f"# {_PROFILES}", ""])


def with_origins(config: RigConfig, origins: Mapping[str, str]) -> str:
    """The effective configuration as TOML, with a comment at each value that is not a default."""
    lines, section = [], ""
    for line in config.to_toml().splitlines():
        if line.startswith("["):
            section = f"{line.strip('[]')}."
        name, equals, _ = line.partition(" = ")
        origin = origins.get(f"{section}{name}") if equals else None
        lines.append(f"{line}  # {origin}" if origin else line)
    return "\n".join(lines) + "\n"


def _keys(section: type[Section], above: tuple[str, ...]) -> Iterator[ConfigKey]:
    meaning, usual = meanings(section), defaults(section)
    for name, kind in key_types(section).items():
        location = (*above, name)
        if isinstance(kind, type) and issubclass(kind, Section):
            yield from _keys(kind, location)
        else:
            yield ConfigKey(".".join(location), limits(location), usual.get(name), meaning[name])


def _gains(controllers: Controllers) -> Iterator[ConfigKey]:
    for name, controller in controllers.items():
        for gain in controller.gains:
            unit = "" if gain.unit == "1" else f" {gain.unit}"
            kind = f"a number at least {gain.low:g} and at most {gain.high:g}{unit}"
            yield ConfigKey(f"{_GAINS}.{gain.name}", kind, gain.default, f"of {name}: {gain.meaning}", name)


def _in_full(key: ConfigKey, below: Mapping[str, Any]) -> str:
    lines = [key.path, *(f"  {line}" for line in _wrapped(key.meaning)), f"  {key.kind}"]
    if key.default is not None:
        lines.append(f"  default {_toml(key.default)}")
    value = _value_in(below, key.path)
    if value is not None and value != key.default:
        lines.append(f"  profile {below.get('profile', '')}: {_toml(value)}")
    return "\n".join(lines)


def _value_in(table: Mapping[str, Any], path: str) -> Any:
    """Value at a dotted path; None if there is none."""
    value: Any = table
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _in_short(key: ConfigKey) -> str:
    default = "" if key.default is None else f" = {_toml(key.default)}"
    return f"{key.path}{default}: {key.kind}{f', of {key.of}' if key.of else ''}"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, break_long_words=False, break_on_hyphens=False)


def _toml(value: Any) -> str:
    """A value as TOML on one line."""
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return tomli_w.dumps({"x": value}).partition(" = ")[2].strip() if value != {} else "{}"
