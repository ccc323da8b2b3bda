"""Writes the folder: sessions, tables for any program, what they are, whose they are, and their hashes."""

from __future__ import annotations

import csv
import json
import secrets
import shutil
from collections.abc import Iterator, Sequence
from datetime import UTC, date, datetime
from importlib.resources import files as resources
from pathlib import Path
from typing import Any, Final, NamedTuple

from inteco_abs.analysis.catalogue import COLUMNS, session_row
from inteco_abs.analysis.publication.anonymous import without_names, write_whole
from inteco_abs.analysis.publication.description import Description
from inteco_abs.analysis.publication.pages import readme, schema
from inteco_abs.errors import ConfigError, SessionError, describe_disk
from inteco_abs.sessions import Session, check_folder, export_session, file_sha256, read_session

_SUMS: Final = "SHA256SUMS"
_READERS: Final = ("read_tables.py", "read_tables.m")


class Publication(NamedTuple):
    """What was written."""

    folder: Path
    sessions: int
    files: tuple[str, ...]
    """Names below the folder, of everything in it."""


def publish(
    files: Sequence[Path],
    out: Path,
    *,
    title: str = "",
    authors: Sequence[str] = (),
    licence: str = "",
    publisher: str = "",
    anonymous: bool = False,
    on: date | None = None,
) -> Publication:
    """Write the sessions in `files` to the new folder `out` as a research object, published `on` a day, or today.

    What is not given comes from the sessions' descriptions: authors as "NAME" or "NAME <ORCID>", a licence by its SPDX
    name or address, the publisher from the institution. An `anonymous` copy names neither computers nor folders. The
    folder appears when it is complete. Raises ConfigError without author or licence, for two sessions of one name and
    for a folder that exists; SessionError for a session that is cut or damaged.
    """
    if out.exists():
        raise ConfigError.of("OUT", f"{out}: exists already; choose another name")
    check_folder(out.absolute().parent, "OUT")
    names = _names(files)
    part = out.with_name(f"{out.name}.{secrets.token_hex(8)}.part")
    sessions = {name: without_names(each) if anonymous else each for name, each in _whole(names)}
    described = Description.of(
        [session.metadata for session in sessions.values()],
        title=title or out.name,
        authors=authors,
        licence=licence,
        publisher=publisher,
        on=on or datetime.now(UTC).date(),
    )
    try:
        try:
            _write(sessions, part, described, anonymous=anonymous)
            part.rename(out)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise SessionError(f"{out} cannot be written: {describe_disk(error)}") from error
    return Publication(out, len(sessions), tuple(each.relative_to(out).as_posix() for each in _below(out)))


def _names(files: Sequence[Path]) -> dict[str, Path]:
    """Files by name without suffix. Raises ConfigError for none, and for a name that comes twice."""
    names = dict[str, Path]()
    for file in files:
        if file.stem in names:
            problem = f"{file}: has the name of {names[file.stem]}, and both would go into one folder; rename one"
            raise ConfigError.of("FILE", problem)
        names[file.stem] = file
    if not names:
        raise ConfigError.of("FILE", "no session there; name session files, or a folder that has some")
    return names


def _whole(names: dict[str, Path]) -> Iterator[tuple[str, Session]]:
    for name, file in names.items():
        session = read_session(file)
        if session.incomplete:
            raise SessionError(f"{file}: {session.incomplete}; publish what inteco-abs recover makes of it")
        yield name, session


def _write(sessions: dict[str, Session], folder: Path, described: Description, *, anonymous: bool) -> None:
    kept, tables = folder / "sessions", folder / "tables"
    kept.mkdir(parents=True)
    tables.mkdir()
    rows = list[dict[str, Any]]()
    for name, session in sessions.items():
        copy = kept / f"{name}.mcap"
        if anonymous:
            write_whole(session, copy)
        else:
            shutil.copyfile(session.path, copy)
        export_session(copy, "csv", tables / f"{name}.csv")
        digest = session.metadata.get("integrity", {}).get("payload_sha256", "")
        rows.append({**session_row(copy), "session": name, "payload_sha256": digest})
    _write_rows(rows, folder / "sessions.csv")
    for name in _READERS:
        (folder / name).write_bytes((resources(__package__) / name).read_bytes())
    texts = {
        "README.md": readme(described, rows, anonymous=anonymous),
        "SCHEMA.md": schema(sessions),
        "LICENSE.txt": described.licence_text(),
        "CITATION.cff": described.citation(),
        "datacite.json": described.datacite(),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    sums = {each.relative_to(folder).as_posix(): (file_sha256(each), each.stat().st_size) for each in _below(folder)}
    (folder / "ro-crate-metadata.json").write_text(described.crate(sums), encoding="utf-8", newline="\n")
    sums["ro-crate-metadata.json"] = (file_sha256(folder / "ro-crate-metadata.json"), 0)
    lines = (f"{digest}  {name}\n" for name, (digest, _) in sorted(sums.items()))
    (folder / _SUMS).write_text("".join(lines), encoding="utf-8", newline="\n")


def _write_rows(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """One row per session, with a column for everything that is known of one of them."""
    names = dict.fromkeys([*COLUMNS, *(name for row in rows for name in row)])
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(
            {name: json.dumps(value) if isinstance(value, list | dict) else value for name, value in row.items()}
            for row in rows
        )


def _below(folder: Path) -> list[Path]:
    return sorted(each for each in folder.rglob("*") if each.is_file())
