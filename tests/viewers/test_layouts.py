"""Layouts for viewers name what sessions hold, in the form that each viewer reads."""

import json
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from mcap.reader import make_reader

from inteco_abs.cli import main
from inteco_abs.views.layouts import layout_of

ENUM, BOOL = FieldDescriptorProto.TYPE_ENUM, FieldDescriptorProto.TYPE_BOOL


@pytest.fixture(scope="module")
def fields(fresh):
    """Type of each field by topic and name, by the descriptors in a file; and the schema of each topic."""
    with fresh.open("rb") as file:
        summary = make_reader(file).get_summary()
    found, schemas = {}, {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        schemas[channel.topic] = schema.name
        for declared in FileDescriptorSet.FromString(schema.data).file:
            for message in declared.message_type:
                if f"{declared.package}.{message.name}" == schema.name:
                    found |= {(channel.topic, field.name): field.type for field in message.field}
    return found, schemas


def leaves(node):
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def branches(node):
    return [] if isinstance(node, str) else [node, *branches(node["first"]), *branches(node["second"])]


@pytest.fixture(scope="module")
def lichtblick_layout():
    return json.loads(layout_of("lichtblick"))


@pytest.fixture(scope="module")
def panels(lichtblick_layout):
    """Panels of Lichtblick's layout, as (type, configuration)."""
    return [(name.split("!")[0], config) for name, config in lichtblick_layout["configById"].items()]


def test_lichtblicks_layout_has_the_keys_of_one(lichtblick_layout):
    assert set(lichtblick_layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert lichtblick_layout["playbackConfig"] == {"speed": 1}


def test_every_panel_of_lichtblick_stands_once_in_its_mosaic(lichtblick_layout):
    assert sorted(leaves(lichtblick_layout["layout"])) == sorted(lichtblick_layout["configById"])


def test_lichtblicks_mosaic_is_a_tree_of_two_branches(lichtblick_layout):
    for node in branches(lichtblick_layout["layout"]):
        assert set(node) == {"direction", "first", "second", "splitPercentage"}
        assert node["direction"] in {"row", "column"}
        assert 0.0 < node["splitPercentage"] < 100.0


def test_panels_are_of_types_that_lichtblick_has(panels):
    assert {kind for kind, _ in panels} == {"Plot", "StateTransitions", "RosOut"}  # the last is what it calls its log
    assert all(config["lichtblickPanelTitle"] == config["foxglovePanelTitle"] for _, config in panels)


def test_every_path_of_lichtblick_is_a_field_of_the_file(panels, fields):
    found, _ = fields
    for kind, config in panels:
        for path in config.get("paths", ()):
            topic, _, name = path["value"].partition(".")
            assert found[topic, name] == ENUM if kind == "StateTransitions" else found[topic, name] not in {ENUM, BOOL}
            assert (path["enabled"], path["timestampMethod"]) == (True, "receiveTime")


def test_lichtblicks_log_shows_the_topic_of_events(panels, fields):
    _, schemas = fields
    (log,) = [config for kind, config in panels if kind == "RosOut"]
    assert schemas[log["topicToRender"]] == "foxglove.Log"


@pytest.fixture(scope="module")
def plotjuggler_layout():
    return ET.fromstring(layout_of("plotjuggler"))  # noqa: S314  our own file


def test_every_curve_is_what_plotjuggler_makes_of_a_number_in_the_file(plotjuggler_layout, fields):
    """Its parser of protobuf joins topic and field with a slash; an enumeration becomes text, which is not a curve."""
    found, _ = fields
    numbers = {f"{topic}/{name}" for (topic, name), kind in found.items() if kind != ENUM}
    curves = [curve.get("name") for curve in plotjuggler_layout.iter("curve")]
    assert len(curves) == len(set(curves)) > 10
    assert set(curves) <= numbers
    assert "/abs/tick/slip" in curves


def test_plotjugglers_elements_are_nested_as_it_loads_them(plotjuggler_layout):
    root = plotjuggler_layout
    assert root.tag == "root"
    (widget,) = root.findall("tabbed_widget")
    assert (widget.get("parent"), widget.get("name")) == ("main_window", "Main Window")
    splitter = widget.find("Tab/Container/DockSplitter")
    areas = splitter.findall("DockArea")
    assert int(splitter.get("count")) == len(areas) == len(splitter.get("sizes").split(";"))
    assert sum(map(float, splitter.get("sizes").split(";"))) == pytest.approx(1.0, abs=1e-4)
    for area in areas:
        (plot,) = area
        assert plot.get("mode") == "TimeSeries"
        assert plot[0].tag == "limitY"


def test_plotjugglers_loader_is_named_and_takes_topics_that_it_can_plot(plotjuggler_layout, fields):
    _, schemas = fields
    plugin = plotjuggler_layout.find("Plugins/plugin")
    assert plugin.get("ID") == "DataLoad MCAP"
    topics = plugin.find("parameters").get("selected_topics").split(";")
    assert set(topics) <= set(schemas)
    assert "/abs/event" not in topics


def test_both_viewers_show_the_same_columns(panels, plotjuggler_layout):
    theirs = {path["value"] for kind, config in panels if kind == "Plot" for path in config["paths"]}
    curves = {curve.get("name") for curve in plotjuggler_layout.iter("curve")}
    assert {path.replace(".", "/") for path in theirs} == curves


@pytest.fixture
def layout(monkeypatch, capfdbinary):
    """Runs the verb in this process: exit code, standard output and error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["inteco-abs", "viewer-layout", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code or 0, *capfdbinary.readouterr()

    return run


@pytest.mark.parametrize("viewer", ["lichtblick", "plotjuggler"])
def test_a_layout_goes_to_a_file_or_to_standard_output(layout, tmp_path, viewer):
    path = tmp_path / "layout"
    assert layout("--for", viewer, "-o", path)[:2] == (0, f"{path}\n".encode())
    assert path.read_bytes() == layout_of(viewer)
    assert layout("--for", viewer)[:2] == (0, layout_of(viewer))


def test_a_file_that_is_there_is_not_overwritten(layout, tmp_path):
    path = tmp_path / "layout.json"
    path.write_text("mine")
    code, _, error = layout("--for", "lichtblick", "-o", path)
    assert (code, path.read_text()) == (2, "mine")
    assert b"exists already" in error


def test_an_unknown_viewer_is_refused_with_those_that_are_known(layout):
    code, _, error = layout("--for", "rviz")
    assert code == 2
    assert b"'lichtblick', 'plotjuggler'" in error


def test_nothing_heavy_is_loaded_to_list_the_verbs():
    code = "import sys, inteco_abs.cli; print(sorted({'numpy', 'foxglove', 'mcap'} & set(sys.modules)))"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"
