"""Controllers of installed packages: entry points of the group `inteco_abs.controllers`, as `name = "module:Class"`.

Looking for them reads what packages say of themselves and imports nothing; a controller is imported when it is used.
"""

from __future__ import annotations

from importlib.metadata import Distribution, EntryPoint, distributions
from itertools import chain
from typing import Final, NamedTuple

from inteco_abs.control import CONTROLLERS, Controller
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.plugins.shape import foreign_code, require_controller

GROUP: Final = "inteco_abs.controllers"
_PATH: Final = "controller.name"


class Packaged(NamedTuple):
    """A controller that an installed package offers."""

    name: str
    distribution: str
    version: str
    entry: EntryPoint
    problem: str = ""
    """Why it cannot be used, as far as can be told without importing it."""

    @property
    def package(self) -> str:
        """Name and version."""
        return f"{self.distribution} {self.version}"

    def load(self) -> type[Controller]:
        """The class, freshly imported; raises ConfigError if it cannot be, or is not a controller."""
        what = f"{self.name} of the package {self.package}"
        if self.problem:
            raise ConfigError([ConfigIssue(_PATH, f"{what}: {self.problem}")])
        with foreign_code(_PATH, what):
            kind = self.entry.load()
        return require_controller(_PATH, kind, f"{what}: {self.entry.value}")


def packaged_controllers() -> dict[str, Packaged]:
    """What all installed packages offer, by name. A name that two offer, or that ships, is there with its problem."""
    found: dict[str, Packaged] = {}
    for offer in chain.from_iterable(map(_offers, distributions())):
        other = found.setdefault(offer.name, offer)
        if offer.name in CONTROLLERS:
            problem = "a controller of this name ships with inteco-abs; the package's author must choose another name"
        elif other.distribution != offer.distribution:
            problem = f"the package {offer.package} offers one of this name too; uninstall one of them"
        else:
            continue  # the only one, or the same package further down the path, which would not be imported
        found[offer.name] = other._replace(problem=problem)
    return found


def _offers(distribution: Distribution) -> list[Packaged]:
    """What one package offers; nothing if its lists cannot be read, which may have nothing to do with us."""
    try:
        if f"[{GROUP}]" not in (distribution.read_text("entry_points.txt") or ""):
            return []
        entries = distribution.entry_points.select(group=GROUP)
        return [Packaged(entry.name, distribution.name, distribution.version, entry) for entry in entries]
    except Exception:  # noqa: BLE001  whatever others have installed, the rig must be usable
        return []
