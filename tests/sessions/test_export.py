"""Every value of a session arrives in other programs' files as it is, with its unit."""

import csv
import json
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest
import scipy.io

from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import AbsError, ConfigError, SessionError
from inteco_abs.quantities import Quantity
from inteco_abs.sessions import FORMATS, export_session, gains_of, tables, to_pandas, to_polars
from inteco_abs.signals import BrakeDemand, Phase

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
    names = ["stop.csv", "stop.truth.csv", "stop.events.csv", "stop.csv-metadata.json"]
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


def test_csv_has_the_metadata_and_every_unit_and_meaning_in_a_file_beside_it(exported, quick):
    expected, files = exported("csv")
    content = json.loads(files["metadata"].read_text(encoding="utf-8"))
    assert content["@context"] == "http://www.w3.org/ns/csvw"
    for described, (name, table) in zip(content["tables"], expected.items(), strict=True):
        columns = described["tableSchema"]["columns"]
        with (files[name].parent / described["url"]).open(encoding="utf-8", newline="") as file:
            assert next(csv.reader(file)) == [column["titles"] for column in columns]
        assert {column["name"]: column.get("schema:unitText", "") for column in columns} == table.units
        assert {column["name"]: column["dc:description"] for column in columns} == table.meanings
    types = {column["name"]: column["datatype"] for column in content["tables"][0]["tableSchema"]["columns"]}
    assert (types["slip"], types["tick"], types["estimate_valid"]) == ("double", "integer", "boolean")
    facts = {each["schema:name"]: each["schema:value"] for each in content["schema:additionalProperty"]}
    assert facts["session.outcome"] == "completed"
    assert float.fromhex(facts["controller.gain.Mk.hex"]) == 2.0
    assert int(facts["epoch.unix_ns"]) == quick.session.epoch_ns


@pytest.mark.parametrize("form", FORMATS)
def test_internals_have_the_names_units_and_meanings_that_their_law_declares(exported, form):
    expected, files = exported(form)
    table = expected["tick"]
    slip_rate = table.column("f_per_s")
    assert slip_rate[table.column("phase") == Phase.BRAKING].any()
    match form:
        case "csv":
            content = json.loads(files["metadata"].read_text(encoding="utf-8"))
            columns = {column["name"]: column for column in content["tables"][0]["tableSchema"]["columns"]}
            units = {name: column.get("schema:unitText") for name, column in columns.items()}
            meaning = columns["f_per_s"]["dc:description"]
            found = np.genfromtxt(files["tick"], delimiter=",", names=True)["f_per_s"]
        case "npz":
            with np.load(files["tick"]) as archive:
                units, meanings = (json.loads(str(archive[name]))["tick"] for name in ("units", "meanings"))
                meaning, found = meanings["f_per_s"], archive["tick"]["f_per_s"]
        case "mat":
            content = scipy.io.loadmat(files["tick"], simplify_cells=True)
            units, meaning = content["units"]["tick"], content["meanings"]["tick"]["f_per_s"]
            found = content["tick"]["f_per_s"]
        case "parquet":
            content = pq.read_table(files["tick"])
            units = {field.name: field.metadata[b"unit"].decode() for field in content.schema}
            meaning = content.schema.field("f_per_s").metadata[b"meaning"].decode()
            found = content["f_per_s"].to_numpy()
    assert same(found, slip_rate)
    assert (units["f_per_s"], units["g_per_s_nm"], units["torque_eq_nm"]) == ("1/s", "1/(s.N.m)", "N.m")
    assert "without brake torque" in meaning
    assert "c3" in units
    assert "c0" not in units


class Named:
    gains = ()
    internals = ("own", Quantity("slip", "1", "own slip"), "", Quantity("two words", "N.m", "a torque"))

    def __init__(self, setup):
        pass

    def update(self, *_):
        return BrakeDemand(0.5, internals=(1.0, 2.0, 3.0, 4.0))


def test_a_name_that_is_taken_or_no_name_stays_in_the_meaning(run):
    session = run("controller.name='named'", controllers={**CONTROLLERS, "named": Named}).session
    table = tables(session)[0]
    braking = table.column("phase") == Phase.BRAKING
    columns = ("own", "c1", "c2", "c3")
    assert [table.column(name)[braking].max() for name in columns] == [1.0, 2.0, 3.0, 4.0]
    assert [table.units[name] for name in columns] == ["", "1", "", "N.m"]
    assert table.meanings["c1"] == "slip: own slip"
    assert table.meanings["c3"] == "two words: a torque"
    assert table.units["slip"] == "1"
    assert to_pandas(session).attrs["units"] == table.units
    assert "own" in to_polars(session).columns


def test_units_of_internals_that_an_older_session_did_not_declare_are_unknown(quick):
    channel = {"units": '{"c0": "1"}', "describe": '{"c0": "controller internal"}', "internals": '["f_per_s"]'}
    older = replace(quick.session, channels={"/abs/tick": channel})
    assert tables(older)[0].units["f_per_s"] == ""
    for damaged in ("{", "3", "[[1]]", '{"c0": 3}', "[" * 100_000):
        assert gains_of({"/abs/params": {"units": damaged}}) == ()
        assert "c0" in tables(replace(older, channels={"/abs/tick": {"internals": damaged}}))[0].units


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
            assert "".join(content["units"][name][column]) == table.units[column]
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
    assert [written.tables for written in made.files] == [("tick",), *([("metadata",)] if form == "csv" else [])]
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
