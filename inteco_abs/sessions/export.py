"""Exports a session's tables to CSV and NumPy and, with an extra, to MATLAB and Parquet."""

from __future__ import annotations

import csv
import importlib.util
import json
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from inteco_abs.errors import AbsError, ConfigError, SessionError, describe_disk, near_match
from inteco_abs.sessions.files import atomic_write, check_output
from inteco_abs.sessions.locations import is_local
from inteco_abs.sessions.reader import Session, read_session
from inteco_abs.sessions.tables import Table, tables

_CSVW_TYPES: Final = {"f": "double", "i": "integer", "u": "integer", "b": "boolean", "U": "string"}
"""Types of columns by numpy's kinds."""


class ExportedFile(NamedTuple):
    """A file of an export."""

    path: Path
    tables: tuple[str, ...]
    rows: int
    """Rows of all its tables; of the metadata, the columns described."""


class Export(NamedTuple):
    """Result of an export."""

    session: Session
    files: list[ExportedFile]


class _Format(NamedTuple):
    write: Callable[[Path, list[Table], Session], None]
    one_table_a_file: bool
    package: str = ""
    """Required package; empty for the base install."""
    companion: bool = False
    """Whether a file of metadata, units and meanings is written beside it, as its files cannot hold them."""


def export_target(source: Path, form: str | None, out: Path | None) -> tuple[str, Path]:
    """Format and file of an export: each follows from the other. Raises ConfigError if they do not agree."""
    if form is not None and form not in FORMATS:
        raise ConfigError.of("--format", f"no format {form!r}{near_match(form, FORMATS)}")
    if out is None:
        if form is None:
            raise ConfigError.of("--format", f"missing: name {', '.join(FORMATS)}, or an --out that ends so")
        return form, (source if is_local(source) else Path(source.name)).with_suffix(f".{form}")
    ending = out.suffix.removeprefix(".")
    wanted = tuple(FORMATS) if form is None else (form,)
    if ending not in wanted:  # programs open a file by its suffix
        raise ConfigError.of("--out", f"{out}: must end in .{', .'.join(wanted)}")
    return ending, out


def export_session(source: Path | Session, form: str, out: Path) -> Export:
    """Write a session, or the one at a path, to `out` in one of `FORMATS`.

    An hour needs little memory. In a format with one table per file, `out` has the ticks; the other tables go to files
    beside it, such as `stop.truth.csv`, and metadata that the format cannot hold to `stop.csv-metadata.json`. Raises
    ConfigError, SessionError, or AbsError if the format's package is not installed.
    """
    chosen = FORMATS[form]
    if chosen.package and importlib.util.find_spec(chosen.package) is None:
        raise AbsError(f"--format {form} needs {chosen.package}: pip install 'inteco-abs[export]'")
    check_output(out)
    session = source if isinstance(source, Session) else read_session(source)
    found = tables(session)
    groups = [[table] for table in found] if chosen.one_table_a_file else [found]
    paths = [out, *(out.with_name(f"{out.stem}.{group[0].name}{out.suffix}") for group in groups[1:])]
    companion = out.with_name(f"{out.name}-metadata.json")  # where readers of CSVW look for it
    for path in (*paths[1:], *([companion] if chosen.companion else [])):
        check_output(path)
    with ExitStack() as parts:
        for path, group in zip(paths, groups, strict=True):
            _write(chosen.write, path, parts.enter_context(atomic_write(path)), group, session)
        if chosen.companion:
            write = partial(_csvw, [path.name for path in paths])
            _write(write, companion, parts.enter_context(atomic_write(companion)), found, session)
    files = [
        ExportedFile(path, tuple(table.name for table in group), sum(table.number for table in group))
        for path, group in zip(paths, groups, strict=True)
    ]
    columns = sum(len(table.units) for table in found)
    return Export(session, [*files, *([ExportedFile(companion, ("metadata",), columns)] if chosen.companion else [])])


def _write(
    write: Callable[[Path, list[Table], Session], None], path: Path, part: Path, group: list[Table], session: Session
) -> None:
    try:
        write(part, group, session)
    except (OSError, ValueError) as error:  # scipy's own errors of arrays too large for its format are ValueErrors
        why = describe_disk(error) if isinstance(error, OSError) else error
        raise SessionError(f"{path} cannot be written: {why}") from error


def _csv(path: Path, group: list[Table], _session: Session) -> None:
    (table,) = group
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table.units)
        for rows in table.blocks():
            columns = [rows[name] for name in table.units]
            numbers = [column.view(np.uint8) if column.dtype == bool else column for column in columns]
            writer.writerows(zip(*(column.tolist() for column in numbers), strict=True))


def _csvw(names: list[str], path: Path, group: list[Table], session: Session) -> None:
    """Metadata of the csv files `names` as CSV on the Web (W3C) has them; units are UCUM."""
    facts = {"epoch.unix_ns": str(session.epoch_ns)}
    facts |= {f"{record}.{key}": value for record, each in session.metadata.items() for key, value in each.items()}
    described = [
        {"url": name, "tableSchema": {"columns": [_csvw_column(table, column) for column in table.units]}}
        for name, table in zip(names, group, strict=True)
    ]
    content = {
        "@context": "http://www.w3.org/ns/csvw",
        "tables": described,
        "schema:additionalProperty": [{"schema:name": key, "schema:value": value} for key, value in facts.items()],
    }
    path.write_text(json.dumps(content, indent=1), encoding="utf-8", newline="\n")


def _csvw_column(table: Table, name: str) -> dict[str, str]:
    kind, unit, meaning = table.dtype[name].kind, table.units[name], table.meanings[name]
    column = {"name": name, "titles": name, "datatype": _CSVW_TYPES[kind], "schema:unitText": unit}
    column |= {"dc:description": meaning, "null": "nan" if kind == "f" else ""}
    return {key: text for key, text in column.items() if text}


def _npz(path: Path, group: list[Table], session: Session) -> None:
    from numpy.lib.recfunctions import repack_fields  # noqa: PLC0415  it loads masked arrays, a third of numpy's time

    with zipfile.ZipFile(path, "x") as archive:
        for table in group:
            packed = repack_fields(np.empty(0, table.dtype))
            with archive.open(f"{table.name}.npy", "w", force_zip64=True) as file:
                head = {"descr": npy.dtype_to_descr(packed.dtype), "fortran_order": False, "shape": (table.number,)}
                npy.write_array_header_2_0(file, head)
                for rows in table.blocks():
                    file.write(repack_fields(rows).tobytes())
        for name, text in _texts(group, session).items():
            with archive.open(f"{name}.npy", "w") as file:
                npy.write_array(file, np.array(text))


def _mat(path: Path, group: list[Table], session: Session) -> None:
    from scipy.io import savemat  # noqa: PLC0415  heavy, and an extra

    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        content: dict[str, Any] = {table.name: _struct(table, Path(folder)) for table in group}
        content["units"] = {table.name: table.units for table in group}
        content["meanings"] = {table.name: table.meanings for table in group}
        content["metadata"] = _texts(group, session)["metadata"]
        with path.open("xb") as file:
            savemat(file, content, long_field_names=True, oned_as="column")


class _ColumnOnDisk:
    """Numbers of a column, which scipy asks for when it writes them: only one column is in memory."""

    def __init__(self, path: Path, dtype: np.dtype[Any]) -> None:
        self._path, self._dtype = path, dtype

    def __array__(self, dtype: Any = None, copy: Any = None) -> npt.NDArray[Any]:
        return np.fromfile(self._path, self._dtype)


def _struct(table: Table, folder: Path) -> dict[str, Any]:
    """Columns by name, as files in `folder`; texts as a cell array."""
    texts = {name for name in table.units if table.dtype[name].kind == "U"}
    if texts:
        return {name: table.rows[name].astype(object) if name in texts else table.rows[name] for name in table.units}
    paths = {name: folder / f"{table.name}.{at}" for at, name in enumerate(table.units)}
    with ExitStack() as files:
        opened = {name: files.enter_context(path.open("xb")) for name, path in paths.items()}
        for rows in table.blocks():
            for name, file in opened.items():
                np.ascontiguousarray(rows[name]).tofile(file)
    return {name: _ColumnOnDisk(path, table.dtype[name]) for name, path in paths.items()}


def write_parquet(path: Path, group: list[Table], session: Session) -> None:
    """Write the one table of `group`, with units, meanings and the session's metadata, to the new file `path`."""
    import pyarrow as pa  # noqa: PLC0415  heavy, and an extra
    from pyarrow import parquet  # noqa: PLC0415

    (table,) = group
    fields = [
        pa.field(
            name,
            pa.string() if values.kind == "U" else pa.from_numpy_dtype(values),
            metadata={"unit": table.units[name], "meaning": table.meanings[name]},
        )
        for name, values in ((name, table.dtype[name]) for name in table.units)
    ]
    schema = pa.schema(fields, metadata={"inteco_abs": _texts(group, session)["metadata"]})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for rows in table.blocks():
            arrays = [pa.array(np.ascontiguousarray(rows[field.name]), field.type) for field in fields]
            writer.write_batch(pa.record_batch(arrays, schema))


def _texts(group: list[Table], session: Session) -> dict[str, str]:
    """Units, meanings and metadata as JSON."""
    return {
        "units": json.dumps({table.name: table.units for table in group}),
        "meanings": json.dumps({table.name: table.meanings for table in group}),
        "metadata": json.dumps({**session.metadata, "epoch": {"unix_ns": str(session.epoch_ns)}}),
    }


FORMATS: Final[dict[str, _Format]] = {
    "csv": _Format(_csv, one_table_a_file=True, companion=True),
    "npz": _Format(_npz, one_table_a_file=False),
    "mat": _Format(_mat, one_table_a_file=False, package="scipy"),
    "parquet": _Format(write_parquet, one_table_a_file=True, package="pyarrow"),
}
