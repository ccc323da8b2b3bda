"""The effective configuration of a run: a board's defaults, rig.toml, a sampled rig, and settings."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex

from inteco_abs.errors import ConfigError, shortened

if TYPE_CHECKING:
    from inteco_abs.config import Check, RigConfig, Table


def run_config(
    board: str,
    file: Path | None,
    settings: Sequence[str],
    rig: str | None,
    checks: Sequence[Check] = (),
    follows: Callable[[Table], Table] | None = None,
    more: Sequence[str] = (),
) -> RigConfig:
    """Configuration of a run with the `board`; `rig` is a sampled one, and `more` settings are over all others.

    Raises ConfigError.
    """
    from inteco_abs.boards import check_address, default_profile, kind_check, simulated
    from inteco_abs.config import load_config
    from inteco_abs.mock_board import rig_check
    from inteco_abs.population_file import rig_settings

    check_address(board)
    if rig is not None and not simulated(board):
        raise ConfigError.of("--rig", f"{board}: a real board has its own rig; use --rig with --board sim: only")
    lines = [*settings, *setting_lines(rig_settings(rig, "--rig")), *more]
    return load_config(file, lines, (*checks, kind_check, rig_check), default_profile(board), follows)


def setting_lines(settings: Mapping[str, Any]) -> list[str]:
    """Values by dotted key as KEY=VALUE. Raises ConfigError for a value that rig.toml cannot have."""
    return [f"{key}={_text(key, value)}" for key, value in settings.items()]


def varied_lines(settings: Mapping[str, Any]) -> list[str]:
    """As `setting_lines`, where a list or an array has several values to try, as KEY=VALUE,VALUE."""
    given = {key: _plain(value) for key, value in settings.items()}
    return [
        f"{key}={','.join(_text(key, each) for each in (value if isinstance(value, list) else [value]))}"
        for key, value in given.items()
    ]


def is_varied(value: Any) -> bool:
    """Whether it is several values to try."""
    return isinstance(_plain(value), list)


def _text(key: str, given: Any) -> str:
    """A value as in TOML, which writes finite numbers, text, booleans and lists as JSON does."""
    value = _plain(given)
    if isinstance(value, SupportsFloat) and not isinstance(value, int):
        return repr(float(value))
    try:
        return json.dumps(value)
    except TypeError:
        problem = f"{shortened(given)}: must be a number, text, true or false, or a list of them"
        raise ConfigError.of(key, problem) from None


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy, tuples and ranges as Python's own."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping) else value


def chosen_settings(
    settings: Mapping[str, Any] | None,
    gains: Mapping[str, Any] | None = None,
    controller: str | None = None,
    estimator: str | None = None,
) -> dict[str, Any]:
    """All of them by dotted key, as in rig.toml."""
    names = {"controller.name": controller, "estimator.name": estimator}
    return {
        **(settings or {}),
        **{f"controller.gains.{name}": value for name, value in (gains or {}).items()},
        **{key: name for key, name in names.items() if name is not None},
    }


def as_list(given: object) -> list[Any]:
    """One or several of them."""
    return list(given) if isinstance(given, Iterable) and not isinstance(given, str | type) else [given]


def require_whole(path: str, value: object, least: int, most: int) -> None:
    """Raise ConfigError for `path` unless it is a whole number in this range."""
    if isinstance(value, bool) or not isinstance(value, SupportsIndex) or not least <= value.__index__() <= most:
        raise ConfigError.of(path, f"{shortened(value)}: must be a whole number in {least}..{most}")
