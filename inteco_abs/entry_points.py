"""Parts that ship and parts that installed packages add: one way to find controllers, estimators and board families.

A package adds one as an entry point, `name = "module:attribute"`, in the group of its kind. Looking for them reads what
packages declare and imports nothing; a part is imported when it is used.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import Distribution, EntryPoint, distributions
from itertools import chain
from typing import Any, Generic, NamedTuple, TypeVar

from inteco_abs.errors import ConfigError, place_in

T = TypeVar("T")


@contextmanager
def foreign_code(path: str, what: str) -> Iterator[None]:
    """Run code of the file or package `what`: any exception becomes a ConfigError, prints go to stderr."""
    try:
        with redirect_stdout(sys.stderr):  # they must not mix with a result card
            yield
    except (Exception, SystemExit) as error:
        text = str(error)
        if isinstance(error, SyntaxError) and error.filename == what:
            text = error.msg  # its text repeats file and line
        raise ConfigError.of(path, f"{what}{place_in(error, what)}: {type(error).__name__}: {text}") from error


def attribute(reference: str) -> Any:
    """Import the attribute that "module:attribute" names."""
    return EntryPoint("", reference, "").load()


class Packaged(NamedTuple):
    """A part that an installed package offers."""

    name: str
    distribution: str
    version: str
    entry: EntryPoint
    problem: str = ""
    """Why it cannot be used, as far as is known without importing it."""

    @property
    def package(self) -> str:
        """Name and version."""
        return f"{self.distribution} {self.version}"


@dataclass(frozen=True, eq=False)
class Registry(Mapping[str, T], Generic[T]):
    """Parts by name: those that ship first, then those of installed packages.

    A part that ships may be text, "module:attribute", and is imported when it is used. A package's part raises
    ConfigError if it cannot be imported, or if `require` (path, part, description) refuses it.
    """

    what: str
    """One part in words, as in "a controller"."""
    group: str
    """Group of the entry points."""
    path: str
    """The configuration's key that names a part."""
    shipped: Mapping[str, T | str]
    require: Callable[[str, object, str], T]

    def __getitem__(self, name: str) -> T:
        if name not in self.shipped:
            return self.load(self.packaged[name])
        part = self.shipped[name]
        return self.require(self.path, attribute(part), part) if isinstance(part, str) else part

    def __contains__(self, name: object) -> bool:
        return name in self.shipped or name in self.packaged

    def __iter__(self) -> Iterator[str]:
        return iter({**self.shipped, **self.packaged})

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def usable(self) -> tuple[dict[str, tuple[T, str]], list[dict[str, str]]]:
        """All parts that can be imported, each with its package or "", and the problems of the others."""
        found, broken = {name: (self[name], "") for name in self.shipped}, []
        for offer in self.packaged.values():
            try:
                found[offer.name] = self.load(offer), offer.package
            except ConfigError as error:
                broken.append({"name": offer.name, "package": offer.package, "problem": error.mistakes[0].problem})
        return found, broken

    @cached_property
    def packaged(self) -> dict[str, Packaged]:
        """What all installed packages offer, by name. A name that two offer, or that ships, stands with its problem."""
        found: dict[str, Packaged] = {}
        for offer in chain.from_iterable(_offers(one, self.group) for one in distributions()):
            other = found.setdefault(offer.name, offer)
            if offer.name in self.shipped:
                problem = (
                    f"{self.what} of this name ships with inteco-abs; the package's author must choose another name"
                )
            elif other.distribution != offer.distribution:
                problem = f"the package {offer.package} offers one of this name too; uninstall one of them"
            else:
                continue  # the only one, or the same package further down the path, which would not be imported
            found[offer.name] = other._replace(problem=problem)
        return found

    def load(self, offer: Packaged) -> T:
        """The part of one package, freshly imported; raises ConfigError if it cannot be used."""
        what = f"{offer.name} of the package {offer.package}"
        if offer.problem:
            raise ConfigError.of(self.path, f"{what}: {offer.problem}")
        with foreign_code(self.path, what):
            part = offer.entry.load()
        return self.require(self.path, part, f"{what}: {offer.entry.value}")


def _offers(distribution: Distribution, group: str) -> list[Packaged]:
    """The parts of one package; none if its entry points cannot be read."""
    try:
        if f"[{group}]" not in (distribution.read_text("entry_points.txt") or ""):
            return []
        entries = distribution.entry_points.select(group=group)
        return [Packaged(entry.name, distribution.name, distribution.version, entry) for entry in entries]
    except Exception:  # noqa: BLE001  a broken package must not make the rig unusable
        return []
