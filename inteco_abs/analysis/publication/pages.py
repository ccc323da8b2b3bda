"""The pages of a publication for its readers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from inteco_abs.analysis.publication.description import Description
from inteco_abs.sessions import Session, Table, tables
from inteco_abs.version import __version__

_SHOWN: Final = ("session", "started_utc", "controller", "estimator", "rig", "outcome", "ticks")


def readme(described: Description, rows: Sequence[Mapping[str, Any]], *, anonymous: bool) -> str:
    """Content of README.md."""
    people = ", ".join(
        f"{author.name} (https://orcid.org/{author.orcid})" if author.orcid else author.name
        for author in described.authors
    )
    shown = [name for name in _SHOWN if any(row.get(name) for row in rows)]
    copied = (
        " Names of computers and folders were left out; ticks and their hashes are as recorded." if anonymous else ""
    )
    return f"""# {described.title}

{described.abstract}

{people}. {described.publisher}, {described.on.isoformat()}.
Licence: [{described.licence}]({described.licence_address}). Cite it as `CITATION.cff` says.

## Sessions

{_table(shown, ([row.get(name, "") for name in shown] for row in rows))}

`sessions.csv` has everything that is known of each, with the SHA-256 of its ticks (`payload_sha256`).{copied}

## Files

* `sessions/*.mcap`: each run as recorded, in the open container format MCAP (https://mcap.dev) with protobuf schemas.
* `tables/*.csv`: the same rows as text: one line per tick, the simulation's true states (`.truth.csv`) and the log
  (`.events.csv`) if there are any. `tables/*.csv-metadata.json` has unit and meaning of each column (CSV on the Web,
  W3C); `SCHEMA.md` shows them.
* `read_tables.py` (Python, standard library) and `read_tables.m` (GNU Octave) read every table without other software.
* `SHA256SUMS`: `sha256sum -c SHA256SUMS` checks every file.
* `ro-crate-metadata.json`, `datacite.json`: this page for machines.

With inteco-abs {__version__}, `inteco-abs replay sessions/NAME.mcap` repeats the controller's decisions bit for bit.
"""


def schema(sessions: Mapping[str, Session]) -> str:
    """Content of SCHEMA.md: columns of all tables, by the sessions that have them."""
    known = dict[str, tuple[Table, list[str]]]()
    for name, session in sessions.items():
        version = session.metadata.get("session", {}).get("format_version", "")
        for table in tables(session):
            title = f"{table.name}, format {version}"
            lines = _table(("column", "type", "unit", "meaning"), _columns(table))
            known.setdefault(f"{title}\n\n{lines}", (table, []))[1].append(name)
    parts = [
        f"## {text.partition(chr(10))[0]}\n\nOf {', '.join(names)}.\n{text.partition(chr(10))[2]}\n"
        for text, (_, names) in known.items()
    ]
    head = "# Columns\n\nUnits are UCUM (https://ucum.org); `1` has no dimension. Missing numbers are `nan`.\n\n"
    return head + "\n".join(parts)


def _columns(table: Table) -> Iterator[Sequence[str]]:
    for name, unit in table.units.items():
        yield name, table.dtype[name].name, unit, table.meanings[name]


def _table(names: Sequence[str], rows: Iterator[Sequence[Any]] | Any) -> str:
    lines = ["| " + " | ".join(str(each).replace("|", "\\|") for each in row) + " |" for row in rows]
    return "\n".join([f"| {' | '.join(names)} |", "|" + " --- |" * len(names), *lines])
