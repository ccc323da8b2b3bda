"""Populations of virtual rigs in files of the user's own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from inteco_abs.errors import ConfigError
from inteco_abs.rig import POPULATIONS, draw

SUFFIX: Final = ".toml"
_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_MOST_BYTES: Final = 100_000


def read_population(file: str, option: str) -> tuple[str, str]:
    """Name and text of the population in a .toml file. Raises ConfigError for `option`, which names file and key."""

    def mistake(problem: str) -> ConfigError:
        return ConfigError.of(option, f"{file}: {problem}")

    path = Path(file)
    if not _NAME.fullmatch(path.stem):
        raise mistake("its name must be of letters, digits, - and _, as in my-lab.toml")
    if path.stem in POPULATIONS:
        raise mistake(f"{path.stem} is a shipped population; give the file another name")
    try:
        with path.open("rb") as stream:
            content = stream.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise mistake(f"must have at most {_MOST_BYTES} bytes")
        text = content.decode("utf-8") + "\n"
        draw(text, 0)
    except OSError as error:
        raise mistake(error.strerror or str(error)) from error
    except ValueError as error:
        raise mistake(str(error)) from error
    return path.stem, text


def rig_settings(rig: str | None, option: str) -> dict[str, str]:
    """Values by key of the configuration for a rig named "hard:17" or "my-lab.toml:17"; raises as `read_population`."""
    if rig is None:
        return {}
    population, _, seed = rig.rpartition(":")
    if not population.endswith(SUFFIX):
        return {"simulation.rig": rig}
    name, text = read_population(population, option)
    return {"simulation.rig": f"{name}:{seed}", "simulation.population": text}
