"""Every value of a session arrives in other programs' files as it is, with its unit."""

import csv
import json
import sys

import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest
import scipy.io

from inteco_abs.errors import AbsError, ConfigError, SessionError
from inteco_abs.sessions import FORMATS, export_session, tables, to_pandas, to_polars

COLUMN_COUNTS = {"tick": 28, "truth": 8, "events": 4}


@pytest.fixture
def exported(quick, tmp_path):
    """The quick session in a format: its tables, and the files by table."""

    def run(form):
        made = export_session(quick.path, form, tmp_path / f"stop.{form}")
        return {table.name: table for table in tables(quick.session)}, {
            name: written.path for written in made.files for name in written.tables
        }

    return run


def same(found, expected):
    return np.array_equal(np.asarray(found), expected, equal_nan=expected.dtype.kind == "f")


def test_tables_have_every_column_with_unit_and_meaning(quick):
    for table in tables(quick.session):
        assert len(table.units) == len(table.meanings) == len(table.rows.dtype.names) == COLUMN_COUNTS[table.name]
    tick = tables(quick.session)[0]
    assert tick.units["torque_demand_nm"] == "N.m"
    assert "4 BRAKING" in tick.meanings["phase"]


def test_events_are_on_the_clock_of_the_ticks(quick):
    tick, _, events = tables(quick.session)
    assert events.rows["text"].tolist()[0] == "phase IDLE"
    assert set(events.rows["time_ns"].tolist()) <= set(tick.rows["time_ns"].tolist())


def test_rows_are_exported_as_csv(exported):
    expected, files = exported("csv")
    names = ["stop.csv", "stop.truth.csv", "stop.events.csv", "stop.columns.csv"]
    assert [path.name for path in files.values()] == names
    for name, table in expected.items():
        with files[name].open(encoding="utf-8", newline="") as file:
            head, *lines = list(csv.reader(file))
        assert head == list(table.units)
        assert len(lines) == len(table.rows)
        for column, values in zip(head, zip(*lines, strict=True), strict=True):
            wanted = table.column(column)
            read = list(values) if wanted.dtype.kind == "U" else np.array(values, float).astype(wanted.dtype)
            exact = [int(v) for v in values] if wanted.dtype.kind in "iu" else read
            assert same(exact, wanted), column


def test_csv_has_unit_and_meaning_of_every_column_in_a_file_beside_it(exported):
    expected, files = exported("csv")
    with files["columns"].open(encoding="utf-8", newline="") as file:
        found = [(row["table"], row["column"], row["unit"], row["meaning"]) for row in csv.DictReader(file)]
    assert found == [
        (table.name, name, unit, table.meanings[name])
        for table in expected.values()
        for name, unit in table.units.items()
    ]
    assert ("tick", "brake_torque_nm") not in [row[:2] for row in found]
    assert ("truth", "brake_torque_nm", "N.m") in [row[:3] for row in found]


def test_npz(exported):
    expected, files = exported("npz")
    assert len(set(files.values())) == 1
    with np.load(files["tick"]) as archive:
        for name, table in expected.items():
            assert archive[name].dtype.itemsize == sum(archive[name].dtype[c].itemsize for c in table.units)
            for column in table.units:
                assert same(archive[name][column], table.column(column))
        assert json.loads(str(archive["units"]))["tick"]["torque_demand_nm"] == "N.m"
        assert json.loads(str(archive["metadata"]))["session"]["outcome"] == "completed"


def test_mat(exported):
    expected, files = exported("mat")
    content = scipy.io.loadmat(files["tick"], simplify_cells=True)
    for name, table in expected.items():
        for column in table.units:
            assert same(content[name][column], table.column(column)), column
            assert content["units"][name][column] == table.units[column]
    assert json.loads(content["metadata"])["controller"]["name"] == "reaching-law"


def test_parquet(exported):
    expected, files = exported("parquet")
    for name, table in expected.items():
        content = pq.read_table(files[name])
        for column, unit in table.units.items():
            assert same(content[column].to_numpy(), table.column(column)), column
            assert content.schema.field(column).metadata[b"unit"].decode() == unit
        assert b"reaching-law" in content.schema.metadata[b"inteco_abs"]


@pytest.mark.parametrize("form", FORMATS)
def test_a_cut_session_is_exported_as_far_as_it_goes(quick, altered, tmp_path, form):
    made = export_session(altered(quick.path.read_bytes()[:-500]), form, tmp_path / f"cut.{form}")
    assert made.session.incomplete
    assert made.files[0].rows >= quick.stop.card["ticks"]


@pytest.mark.parametrize("form", FORMATS)
def test_a_session_without_truth_or_events_has_no_such_tables(altered, short, tmp_path, form, before_its_ticks):
    made = export_session(altered(before_its_ticks(short.read_bytes())), form, tmp_path / f"empty.{form}")
    assert [written.tables for written in made.files] == [("tick",), *([("columns",)] if form == "csv" else [])]
    assert made.files[0].rows == 0


@pytest.mark.parametrize("form", FORMATS)
def test_a_full_disk_leaves_nothing(quick, tmp_path, room, form):
    room(30_000)
    with pytest.raises(SessionError):
        export_session(quick.path, form, tmp_path / f"stop.{form}")
    room(-1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_nothing_is_overwritten_nor_half_done(quick, tmp_path, form):
    (tmp_path / f"stop.truth.{form}").write_text("mine")
    with pytest.raises(ConfigError, match="never overwritten"):
        export_session(quick.path, form, tmp_path / f"stop.{form}")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize(("form", "package"), [("mat", "scipy"), ("parquet", "pyarrow")])
def test_without_the_extra_it_is_said_what_to_install(quick, tmp_path, monkeypatch, form, package):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(AbsError, match=rf"{package}: pip install 'inteco-abs\[export\]'"):
        export_session(quick.path, form, tmp_path / f"stop.{form}")


@pytest.mark.parametrize("name", COLUMN_COUNTS)
def test_pandas(quick, name):
    table = {table.name: table for table in tables(quick.session)}[name]
    frame = to_pandas(quick.session, name)
    assert isinstance(frame, pd.DataFrame)
    assert frame.attrs["units"] == table.units
    for column in table.units:
        assert same(frame[column].to_numpy(table.column(column).dtype), table.column(column))


@pytest.mark.parametrize("name", COLUMN_COUNTS)
def test_polars(quick, name):
    table = {table.name: table for table in tables(quick.session)}[name]
    frame = to_polars(quick.session, name)
    assert isinstance(frame, pl.DataFrame)
    for column in table.units:
        assert same(frame[column].to_numpy(), table.column(column))


def test_a_table_that_is_not_there_is_named(quick):
    with pytest.raises(ConfigError, match="'ticks'; did you mean tick"):
        to_pandas(quick.session, "ticks")


@pytest.mark.parametrize(("package", "convert"), [("pandas", to_pandas), ("polars", to_polars)])
def test_without_a_data_frame_library_it_is_said_what_to_install(quick, monkeypatch, package, convert):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(AbsError, match=f"pip install {package}"):
        convert(quick.session)
