"""All controllers by name: shipped ones, the user's, and those of installed packages."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from inteco_abs.control import CONTROLLERS, Controller
from inteco_abs.entry_points import Registry
from inteco_abs.plugins.shape import require_controller
from inteco_abs.published import PUBLISHED
from inteco_abs.version import __version__


def installed_controllers() -> Registry[type[Controller]]:
    """Shipped controllers, those that others published, and those of installed packages."""
    shipped = CONTROLLERS | PUBLISHED
    return Registry("a controller", "inteco_abs.controllers", "controller.name", shipped, require_controller)


class Origin(NamedTuple):
    """Origin of a controller that is not one of `CONTROLLERS`, for the session."""

    source: bytes = b""
    """Source of the file, or of the package's module if it can be read."""
    package: str = ""
    """Name and version of the package, for a published law inteco-abs; empty if it comes from a file."""


class Controllers(Mapping[str, type[Controller]]):
    """Controllers by name: `own` first, then shipped ones, then those of packages, imported when used.

    Access raises ConfigError if a package's controller cannot be imported or is not a controller.
    """

    def __init__(self, own: Mapping[str, tuple[type[Controller], Origin]] | None = None) -> None:
        self._own = own or {}
        self._installed = installed_controllers()

    def __getitem__(self, name: str) -> type[Controller]:
        if name in self._own:
            return self._own[name][0]
        return self._installed[name]

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._installed

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._own, *self._installed]))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def origin(self, name: str) -> Origin:
        """Origin of the controller `name`; empty if it is shipped."""
        if name in self._own:
            return self._own[name][1]
        if name in CONTROLLERS:
            return Origin()
        package = f"inteco-abs {__version__}" if name in PUBLISHED else self._installed.packaged[name].package
        return Origin(_source_of(self[name]), package)


def _source_of(kind: type) -> bytes:
    """Source of the module that defines `kind`; empty if it is compiled, in an archive, or gone."""
    try:
        file = Path(inspect.getfile(kind))
        return file.read_bytes() if file.suffix == ".py" else b""
    except (OSError, TypeError):
        return b""
