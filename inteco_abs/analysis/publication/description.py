"""Who made a publication, under which licence, and what is in it, in the formats that repositories read.

RO-Crate 1.1 (https://w3id.org/ro/crate/1.1), DataCite 4.5 (https://schema.datacite.org/meta/kernel-4.5) and the
Citation File Format 1.2.0 (https://citation-file-format.github.io).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from typing import Any, Final, NamedTuple, Self
from urllib.parse import quote

from inteco_abs.errors import ConfigError
from inteco_abs.sessions import DESCRIPTION, Metadata
from inteco_abs.version import __version__

_ORCID: Final = "https://orcid.org/"
_AUTHOR: Final = re.compile(r"\s*([^<>]*[^<>\s])\s*(?:<(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])>)?\s*")
_SPDX: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
_CONTEXT: Final = "https://w3id.org/ro/crate/1.1"
_SOFTWARE: Final = "#inteco-abs"
_WHAT: Final = {
    "": "About the publication",
    "sessions": "Session of the Inteco anti-lock braking rig, with every tick, as MCAP",
    "tables": "Rows of a session, or their units and meanings as CSV on the Web",
}
"""What a file is, by its folder."""
_MEDIA: Final = {
    "mcap": "application/vnd.mcap",
    "csv": "text/csv",
    "json": "application/json",
    "md": "text/markdown",
    "cff": "application/yaml",
    "txt": "text/plain",
    "py": "text/x-python",
    "m": "text/x-octave",
}


class Author(NamedTuple):
    """A person."""

    name: str
    orcid: str = ""
    """As 0000-0002-1825-0097, or empty."""
    institution: str = ""

    @property
    def parts(self) -> tuple[str, str]:
        """Given and family name: the last word."""
        given, _, family = self.name.rpartition(" ")
        return given, family

    @property
    def address(self) -> str:
        """Identifier in the crate."""
        return f"{_ORCID}{self.orcid}" if self.orcid else _local(self.name)


class Description(NamedTuple):
    """What every page and format says."""

    title: str
    authors: tuple[Author, ...]
    licence: str
    """SPDX name or address."""
    publisher: str
    on: date
    abstract: str
    keywords: tuple[str, ...]

    @classmethod
    def of(
        cls,
        sessions: Iterable[Metadata],
        *,
        title: str,
        authors: Sequence[str],
        licence: str,
        publisher: str,
        on: date,
    ) -> Self:
        """What the sessions say of themselves, where nothing else is given. Raises ConfigError for what is missing."""
        facts = [metadata.get(DESCRIPTION, {}) for metadata in sessions]
        found = [_author(text) for text in authors] or [
            Author(each["operator"], each.get("orcid", ""), each.get("institution", ""))
            for each in facts
            if each.get("operator")
        ]
        if not found:
            raise ConfigError.of("--author", "no author is known; give --author, or annotate a session with --operator")
        licences = dict.fromkeys(filter(None, [licence])) or _values(facts, "licence")
        if len(licences) != 1:
            known = f"the sessions have {' and '.join(licences)}; choose one" if licences else "no session has one"
            raise ConfigError.of("--licence", f"{known}: --licence CC-BY-4.0, for example")
        (chosen,) = licences
        if not _SPDX.fullmatch(chosen) and not chosen.startswith(("https://", "http://")):
            raise ConfigError.of("--licence", f"{chosen!r}: must be an SPDX name, as CC-BY-4.0, or an address")
        tags = [tag for each in facts for tag in json.loads(each.get("tags") or "[]")]
        return cls(
            title,
            tuple(dict.fromkeys(found)),
            chosen,
            publisher or next(iter(_values(facts, "institution")), found[0].name),
            on,
            " ".join([*_values(facts, "purpose"), *_values(facts, "note")])
            or "Sessions of the Inteco anti-lock braking rig.",
            tuple(dict.fromkeys(["anti-lock braking", "sliding mode control", *tags])),
        )

    @property
    def licence_address(self) -> str:
        """Where the licence is."""
        return self.licence if "://" in self.licence else f"https://spdx.org/licenses/{self.licence}"

    def licence_text(self) -> str:
        """Content of LICENSE.txt."""
        names = ", ".join(author.name for author in self.authors)
        return f"{self.title}\n(c) {self.on.year} {names}\n\nLicence: {self.licence}\n{self.licence_address}\n"

    def citation(self) -> str:
        """Content of CITATION.cff; JSON strings are YAML, too."""
        lines = [
            "cff-version: 1.2.0",
            "type: dataset",
            f"message: {_text('Please cite this dataset as below.')}",
            f"title: {_text(self.title)}",
            f"abstract: {_text(self.abstract)}",
            f"date-released: {self.on.isoformat()}",
            f"{'license-url' if '://' in self.licence else 'license'}: {self.licence}",
            "keywords:",
            *(f"  - {_text(word)}" for word in self.keywords),
            "authors:",
        ]
        for author in self.authors:
            given, family = author.parts
            lines.append(f"  - family-names: {_text(family)}")
            known = {"given-names": given, "orcid": f"{_ORCID}{author.orcid}" if author.orcid else ""}
            known["affiliation"] = author.institution
            lines += [f"    {key}: {_text(value)}" for key, value in known.items() if value]
        return "\n".join([*lines, ""])

    def datacite(self) -> str:
        """Content of datacite.json: what a repository needs for a DOI, except for the DOI."""
        return _json(
            {
                "schemaVersion": "http://datacite.org/schema/kernel-4",
                "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Control experiments"},
                "creators": [_creator(author) for author in self.authors],
                "titles": [{"title": self.title}],
                "publisher": {"name": self.publisher},
                "publicationYear": str(self.on.year),
                "dates": [{"date": self.on.isoformat(), "dateType": "Issued"}],
                "subjects": [{"subject": word} for word in self.keywords],
                "rightsList": [_without_empty(
                    rights=self.licence,
                    rightsUri=self.licence_address,
                    rightsIdentifier="" if "://" in self.licence else self.licence,
                    rightsIdentifierScheme="" if "://" in self.licence else "SPDX",
                )],
                "descriptions": [{"description": self.abstract, "descriptionType": "Abstract"}],
                "formats": ["application/vnd.mcap", "text/csv"],
                "language": "en",
            }
        )  # fmt: skip

    def crate(self, files: Mapping[str, tuple[str, int]]) -> str:
        """Content of ro-crate-metadata.json for `files` with SHA-256 and size in bytes."""
        institutions = {author.institution: None for author in self.authors if author.institution}
        root = {
            "@id": "./",
            "@type": "Dataset",
            "name": self.title,
            "description": self.abstract,
            "datePublished": self.on.isoformat(),
            "license": {"@id": self.licence_address},
            "author": _one_or_all([{"@id": author.address} for author in self.authors]),
            "publisher": {"@id": _local(self.publisher)},
            "keywords": ", ".join(self.keywords),
            "hasPart": [{"@id": name} for name in files],
        }
        people = [
            _without_empty(
                **{"@id": author.address, "@type": "Person", "name": author.name},
                affiliation={"@id": _local(author.institution)} if author.institution else "",
            )
            for author in self.authors
        ]
        made_by = {
            "@id": _SOFTWARE,
            "@type": "SoftwareApplication",
            "name": "inteco-abs",
            "softwareVersion": __version__,
        }
        made = {
            "@id": "#export",
            "@type": "CreateAction",
            "name": "Sessions written as tables",
            "instrument": {"@id": _SOFTWARE},
            "object": _one_or_all([{"@id": name} for name in files if name.startswith("sessions/")]),
            "result": [{"@id": name} for name in files if name.startswith("tables/")],
        }
        graph = [
            {
                "@id": "ro-crate-metadata.json",
                "@type": "CreativeWork",
                "conformsTo": {"@id": _CONTEXT},
                "about": {"@id": "./"},
            },
            root,
            {"@id": self.licence_address, "@type": "CreativeWork", "name": self.licence},
            *people,
            *(
                {"@id": _local(name), "@type": "Organization", "name": name}
                for name in dict.fromkeys([self.publisher, *institutions])
            ),
            made_by,
            made,
            *(_file(name, *facts) for name, facts in files.items()),
        ]
        return _json({"@context": f"{_CONTEXT}/context", "@graph": graph})


def _author(text: str) -> Author:
    found = _AUTHOR.fullmatch(text)
    if found is None:
        raise ConfigError.of("--author", f"{text!r}: must be a name, or as 'Ada Lovelace <0000-0002-1825-0097>'")
    return Author(found[1], found[2] or "")


def _values(facts: Iterable[Mapping[str, str]], key: str) -> dict[str, None]:
    return dict.fromkeys(each[key] for each in facts if each.get(key))


def _creator(author: Author) -> dict[str, Any]:
    given, family = author.parts
    identifier = {"nameIdentifier": f"{_ORCID}{author.orcid}", "nameIdentifierScheme": "ORCID", "schemeUri": _ORCID}
    return _without_empty(
        name=f"{family}, {given}" if given else family,
        nameType="Personal",
        givenName=given,
        familyName=family,
        nameIdentifiers=[identifier] if author.orcid else [],
        affiliation=[{"name": author.institution}] if author.institution else [],
    )


def _file(name: str, sha256: str, size: int) -> dict[str, Any]:
    folder, _, last = name.rpartition("/")
    return {
        "@id": name,
        "@type": "File",
        "name": last,
        "description": _WHAT[folder],
        "encodingFormat": _MEDIA[last.rpartition(".")[2]],
        "contentSize": str(size),
        "sha256": sha256,
    }


def _local(name: str) -> str:
    """Identifier in the crate of something that has no address."""
    return f"#{quote(name)}"


def _one_or_all(values: list[dict[str, str]]) -> Any:
    """JSON-LD in its compact form has no list of one value."""
    return values[0] if len(values) == 1 else values


def _without_empty(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value}


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def _json(value: Any) -> str:
    return json.dumps(value, indent=1, ensure_ascii=False) + "\n"
