"""The Python interface of notebooks and scripts: `import inteco_abs`."""

import html
import importlib.util
import io
import json
import linecache
import multiprocessing
import subprocess
import sys
import time

import numpy as np
import pytest
from rich.console import Console

import inteco_abs
from inteco_abs.control import Gain
from inteco_abs.errors import AbsError, BoardError, ConfigError, SessionError
from inteco_abs.signals import BrakeDemand

QUICK = {"experiment.start_speed_rad_s": 20.0, "experiment.hold_s": 0.05, "experiment.idle_s": 0.02}


class Bang:
    """Full duty or none."""

    gains = (Gain("duty", 0.7, 0.0, 1.0, "1", "while the slip is low"),)
    internals = ()

    def __init__(self, setup, duty):
        self.reference, self.duty = setup.reference_slip, duty

    def update(self, estimate, _dt_s):
        return BrakeDemand(self.duty if estimate.slip < self.reference else 0.0)


@pytest.fixture(scope="module")
def rig():
    return inteco_abs.connect(settings=QUICK)


@pytest.fixture(scope="module")
def stop(rig, tmp_path_factory):
    return rig.run_stop(seed=3, out=tmp_path_factory.mktemp("notebook") / "stop.mcap")


@pytest.fixture(scope="module")
def own(rig, tmp_path_factory):
    return rig.run_stop(Bang, gains={"duty": 0.8}, out=str(tmp_path_factory.mktemp("notebook") / "own.mcap"))


def test_a_stop_is_the_one_of_the_command(stop, main_here):
    settings = [word for key, value in QUICK.items() for word in ("--set", f"{key}={value}")]
    main_here("run", "--virtual", "--seed", 3, *settings, "--out", "same.mcap", check=0)
    assert inteco_abs.open_session("same.mcap").payload == stop.payload
    assert stop.card["outcome"] == "completed"


def test_a_session_has_a_readable_repr(stop):
    assert repr(stop) == f"<Session {stop.path}: {len(stop.ticks)} ticks, completed>"
    console = Console(file=io.StringIO(), width=100)
    console.print(stop)
    assert "COMPLETED" in console.file.getvalue()
    page = stop._repr_html_()  # the name that notebooks call
    assert page.count("<svg") == page.count("</svg>") == 1
    assert "<td>stop distance</td>" in page


def test_a_session_is_a_table_with_units(stop):
    frame = stop.to_pandas()
    assert frame["slip"].tolist() == stop.ticks["slip"].tolist()
    assert frame.attrs["units"]["torque_demand_nm"] == "N.m"
    assert stop.to_polars("truth").height == len(stop.truth)


def test_sessions_are_drawn_beside_one_another(stop, own, tmp_path):
    figure = stop.plot(own, width="one")
    assert [axis.get_ylabel().split(" ")[0] for axis in figure.axes[:3]] == ["speed", "slip,", "brake"]
    figure.savefig(tmp_path / "both.png")
    assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match="must be one of one, two"):
        stop.plot(width="three")


def test_a_class_runs_with_its_gains_and_is_kept(own):
    assert own.metadata["controller"]["name"] == "Bang"
    assert own.metadata["controller"]["gain.duty"] == "0.8"
    assert b"class Bang:" in own.attachments["controller.py"]
    assert max(own.ticks["brake_request"].tolist()) == 0.8


def test_a_class_whose_decisions_do_not_replay_is_warned_of(rig, tmp_path):
    class Counting(Bang):
        calls = 0

        def update(self, estimate, dt_s):
            Counting.calls += 1
            return super().update(estimate, dt_s)._replace(brake=0.5 + 1e-6 * Counting.calls)

    with pytest.warns(UserWarning, match="the decisions do not replay: .* something outside of itself that changes"):
        rig.run_stop(Counting, out=tmp_path / "counting.mcap")


def test_a_programs_own_processes_survive_a_run(rig, tmp_path):
    child = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60.0,))
    child.start()
    try:
        rig.run_stop(Bang, out=tmp_path / "stop.mcap")
        assert child.is_alive()
    finally:
        child.kill()
        child.join()


def test_a_session_replays(stop, own):
    assert stop.replay().differing == 0
    assert own.replay(Bang).differing == 0
    with pytest.raises(ConfigError, match=r"controller: the session was run with the class 'Bang'; pass it"):
        own.replay()


def test_a_class_of_a_notebooks_cell_is_kept(rig, tmp_path, monkeypatch):
    """As IPython runs a cell: in __main__, with its lines in linecache alone."""
    law = "class Cell(Bang):\n    def update(self, estimate, dt_s):\n        return BrakeDemand(TOP)\n"
    cell = f"TOP = 0.6\n\n{law}"
    names = {"__name__": "__main__", "Bang": Bang, "BrakeDemand": BrakeDemand}
    monkeypatch.setitem(linecache.cache, "<cell 1>", (len(cell), None, cell.splitlines(keepends=True), "<cell 1>"))
    exec(compile(cell, "<cell 1>", "exec"), names)  # noqa: S102  as IPython does
    session = rig.run_stop(names["Cell"], out=tmp_path / "cell.mcap")
    assert session.attachments["controller.py"].decode() == law
    assert session.replay(names["Cell"]).differing == 0
    with pytest.raises(ConfigError, match="was run with the class 'Cell'; pass it"):
        session.replay()


def test_replaying_with_another_class_is_warned_of(own):
    class Other(Bang):
        pass

    with pytest.warns(UserWarning, match="source differs from the session's"):
        own.replay(Other)


def test_a_replay_shows_itself(stop):
    found = stop.replay()
    assert repr(found) == f"<Replay: {len(stop.ticks)} ticks, 0 differing>"
    assert "replayed, none differ" in found._repr_html_()


def test_a_cut_session_shows_what_it_has(stop, tmp_path):
    (tmp_path / "cut.mcap").write_bytes(stop.path.read_bytes()[:4000])
    cut = inteco_abs.open_session(tmp_path / "cut.mcap")
    assert cut.incomplete
    assert "never braked" in cut._repr_html_() or "nothing to draw" in cut._repr_html_()
    assert "cut" in repr(cut)


def test_a_drawn_rig_is_another_one(rig, stop, tmp_path):
    drawn = inteco_abs.connect(rig="hard:17", settings=QUICK).run_stop(seed=3, out=tmp_path / "drawn.mcap")
    assert drawn.card["rig"] == "hard:17"
    assert drawn.payload != stop.payload
    assert rig.config().simulation.rig == ""


def test_without_a_name_the_session_lands_in_the_sessions_folder(rig, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert rig.run_stop().path.parent.name == "sessions"


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        (lambda: inteco_abs.connect("usb3:"), ConfigError, "usb3:"),
        (lambda: inteco_abs.connect(rig="hrd:1"), ConfigError, "did you mean hard"),
        (lambda: inteco_abs.connect(settings={"guard.brake_limt": 0.5}), ConfigError, "did you mean brake_limit"),
        (lambda: inteco_abs.connect(config="missing.toml"), ConfigError, "No such file"),
        (lambda: inteco_abs.connect().run_stop("quantum"), ConfigError, "quantum"),
        (lambda: inteco_abs.connect().run_stop(gains={"Mx": 1}), ConfigError, "Mk, Mq"),
        (lambda: inteco_abs.connect().run_stop(gains={"Mk": "a"}), ConfigError, "controller.gains"),
        (lambda: inteco_abs.connect().run_stop(Bang, real_time=True), ConfigError, r"file\.py:Class"),
        (lambda: inteco_abs.connect().run_stop(estimator="eular"), ConfigError, "did you mean euler"),
        (lambda: inteco_abs.connect().run_stop(gains={"Mk": object()}), ConfigError, "must be a number, text"),
        (lambda: inteco_abs.connect().run_stop(int), ConfigError, "the call has .*\n  controller: int has no method"),
        (lambda: inteco_abs.connect().run_stop(7), ConfigError, "controller: 7: must be a name, file.py:Class, or a"),
        (lambda: inteco_abs.connect().run_stop("law.py"), ConfigError, "controller: law.py: name the class too"),
        (lambda: inteco_abs.connect().run_stop(seed=-1), ConfigError, "seed: -1: must be a whole number in 0"),
        (lambda: inteco_abs.connect().run_stop(faults=["vanish"]), ConfigError, "  faults"),
        (lambda: inteco_abs.connect().run_stop(faults="vanish@brake"), ConfigError, "  faults: 'vanish@brake'"),
        (lambda: inteco_abs.connect().run_stop(out="stop.txt"), ConfigError, "out: stop.txt: must end in .mcap"),
        (lambda: inteco_abs.connect("usb2:", rig="hard:1"), ConfigError, "rig: usb2:: a real board has its own rig"),
        (lambda: inteco_abs.sweep(rigs="hrd:0-9"), ConfigError, "the call has a mistake.*\n  rigs: no population"),
        (lambda: inteco_abs.sweep(Bang), ConfigError, "controllers: .*write it to one"),
        (lambda: inteco_abs.sweep(jobs=0), ConfigError, "jobs: 0: must be a whole number in 1..1024"),
        (lambda: inteco_abs.sweep("quantum"), ConfigError, "quantum"),
        (lambda: inteco_abs.sweep(settings={"simulation.rig": "hard:1"}), ConfigError, "the rigs of rigs"),
        (lambda: inteco_abs.design(speeds_rad_s=(50, 20)), ConfigError, "speeds_rad_s: 50 20: must rise; write speeds"),
        (lambda: inteco_abs.design(dead_time_s=0.1), ConfigError, "dead_time_s: needs lag_s"),
        (lambda: inteco_abs.design(lag_s=(0.0, 5.0)), ConfigError, "lag_s: 0.0 5.0: must be in 0..1 s"),
        (lambda: inteco_abs.design(uncertain={"J7": "5%"}), ConfigError, "  uncertain"),
        (lambda: inteco_abs.identify([]), ConfigError, r"sessions: no session has .*record_for_identification\(\)"),
        (lambda: inteco_abs.identify([], assumed={"J3": 0.1}), ConfigError, "assumed: J3: not an assumed"),
        (lambda: inteco_abs.identify([], assumed={"J1": 5}), ConfigError, "assumed: J1: 5: must be a share"),
        (lambda: inteco_abs.connect("usb2:77").run_stop(out="never.mcap"), BoardError, "77"),
        (lambda: inteco_abs.open_session("missing.mcap"), SessionError, "No such file"),
        (lambda: inteco_abs.open_session(__file__), SessionError, "not an MCAP file"),
    ],
)
def test_mistakes_are_reported_in_the_words_of_the_call(wrong, error, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=words) as raised:
        wrong()
    assert "--" not in str(raised.value)
    assert "command line" not in str(raised.value)
    assert not list(tmp_path.rglob("*.mcap"))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda stop: stop.what_if(), "gains: nothing to compare"),
        (lambda stop: stop.what_if(gains={"Mk": range(1, 200)}), "gains: 199 alternatives: must be at most 100"),
        (lambda stop: stop.what_if("quantum"), "quantum"),
        (lambda stop: stop.what_if(gains={"Mk": [1, 2, 3, 4, 5, 6, 7, 8]}).plot(), "a figure shows at most 7"),
        (lambda stop: stop.what_if(gains={"Mk": 3}, duty=-1), "duty: -1: must be a number of 0 or more"),
        (lambda stop: stop.what_if(gains={"Mk": 3}, torque_nm=float("nan")), "torque_nm: nan: must be a number"),
        (lambda stop: stop.diff(stop, sections=["gain"]), "sections: no section 'gain'; did you mean gains"),
        (lambda stop: stop.diff(stop, rel=2), "rel: 2: must be a number in 0..1"),
        (lambda stop: stop.export(), "form: missing: name csv"),
        (lambda stop: stop.export("a.csv", form="npz"), "out: a.csv: must end in .npz"),
        (lambda stop: stop.export(form="xls"), "form: no format 'xls'"),
        (lambda stop: stop.report(out="page.txt"), "out: page.txt: must end in .html"),
        (lambda stop: stop.replay("quantum"), "controller: no controller 'quantum'"),
        (lambda stop: stop.plot(stop), "others: "),
        (lambda stop: stop.plot(style="nature"), "style: 'nature': must be one of plain, ieee"),
        (lambda stop: stop.plot(font_size_pt=99), "font_size_pt: 99: must be in 5..20 pt"),
        (lambda stop: stop.plot(range_s=(2, 1)), r"range_s: \(2, 1\): must be two times that rise"),
        (lambda stop: stop.to_pandas("tock"), "table: "),
    ],
)
def test_mistakes_with_a_session_name_the_argument(stop, wrong, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=words) as raised:
        wrong(stop)
    assert "--" not in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_a_notebook_shows_a_result_once(stop, monkeypatch):
    """In a notebook, rich displays by itself what a console of its prints."""
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("rich.jupyter.display", lambda *_shown: pytest.fail("it is displayed twice"))
    assert "Mk=3" in stop.what_if(gains={"Mk": 3})._repr_html_()


@pytest.mark.long
def test_other_gains_are_asked_on_the_log(stop, main_here):
    found = stop.what_if(gains={"Mk": [1, np.float64(8.0)]}, closed_loop=True)
    names = [each["name"] for each in found.report()["alternatives"]]
    assert names == ["controller.gains.Mk=1", "controller.gains.Mk=8.0"]
    asked = json.loads(
        main_here(
            "what-if", stop.path, "--sweep", "controller.gains.Mk=1,8.0", "--closed-loop", "--json", check=0
        ).stdout
    )
    assert asked == found.report()
    assert [line.get_label() for line in found.plot().axes[0].get_lines()][:2] == ["log", "_child1"]
    assert "<img" in found._repr_html_()
    assert "simulated from there on" in found._repr_html_()
    assert "Mk=1; controller.gains.Mk=8.0" in repr(found)


def test_two_sessions_are_compared(stop, own):
    found = stop.diff(own, sections=["gains", "outcome"])
    assert [change.key for change in found.changes["gains"]] == ["Mk", "Mq", "lag_s", "duty"]
    assert repr(found) == "<Diff: 4 in gains>"
    assert "duty: - -&gt; 0.8" in found._repr_html_()
    assert repr(stop.diff(stop)) == "<Diff: equal>"


def test_a_session_is_reported_and_exported(stop, own, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = stop.report(own)
    assert page.name == "comparison.html"
    assert b"own.mcap" in page.read_bytes()
    whole, part = (each.export(f"{name}.csv") for each, name in ((stop, "whole"), (stop[0.0:0.1], "part")))
    assert [each.files[0].rows for each in (whole, part)] == [len(stop.ticks), len(stop[0.0:0.1].ticks)]
    with np.load(stop.export("a.npz").files[0].path) as arrays:
        assert len(arrays["tick"]) == len(stop.ticks)


def test_controllers_are_compared_on_drawn_rigs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = []
    found = inteco_abs.sweep(
        ["constant-rate", "reaching-law"],
        rigs="hard:3-4",
        gains={"Mq": [2.0, 4.0]},
        settings=QUICK,
        run_up=False,
        jobs=1,
        progress=lambda stops, of: done.append((stops, of)),
    )
    assert len(found.rows) == 4
    assert done[-1] == (8, 8)
    assert repr(found) == "<Sweep of 4 configurations on hard:3-4: 8 of 8 stops>"
    assert found.to_pandas()["seed"].tolist() == [3, 4] * 4
    assert found.facts()[0]["settings"] == {"controller.gains.Mq": "2.0"}
    assert "slip RMS of 2 stops each" in found._repr_html_()
    assert len(found.plot().axes) == 1
    assert not list(tmp_path.iterdir())


def test_gains_are_judged_for_an_uncertain_rig(main_here):
    found = inteco_abs.design("boundary-layer", gains={"Mq": 9}, uncertain={"J1": "5%", "M10": 0.001}, lag_s=(0, 0.02))
    words = ["--uncertain", "J1=5%", "--uncertain", "M10=0.001", "--lag", 0, 0.02, "--set", "controller.gains.Mq=9"]
    report = json.loads(main_here("design", "--controller", "boundary-layer", *words, "--json").stdout)
    assert found.report() == report
    assert repr(found).startswith("<Assessment of boundary-layer, ")
    assert "Mq=9" in repr(found)
    assert "<img" in found._repr_html_()


def test_without_an_extra_it_is_named(stop, monkeypatch):
    find_spec = importlib.util.find_spec
    absent = {"matplotlib", "bokeh", "pyarrow"}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in absent else find_spec(name))
    monkeypatch.setitem(sys.modules, "pandas", None)
    for call, extra in (
        (stop.plot, "figures"),
        (lambda: stop.report(out="page.html"), "report"),
        (lambda: stop.export("a.parquet"), "export"),
    ):
        with pytest.raises(AbsError, match=rf"pip install 'inteco-abs\[{extra}\]'"):
            call()
    with pytest.raises(AbsError, match="pip install pandas"):
        stop.to_pandas()
    assert "inteco-abs[figures]" in html.unescape(stop._repr_html_())


def test_completion_offers_the_interface_alone():
    offered = [name for name in dir(inteco_abs) if not name.startswith("__")]
    assert offered == sorted(name for name in inteco_abs.__all__ if not name.startswith("__"))
    for name in inteco_abs.__all__:
        assert getattr(inteco_abs, name).__doc__


def test_the_command_starts_without_what_notebooks_need():
    script = (
        "import sys, inteco_abs; dir(inteco_abs); print([name for name in sys.modules if name[:10] == 'inteco_abs'])"
    )
    report = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert report == "['inteco_abs']\n"
    with pytest.raises(AttributeError, match="no attribute 'disconnect'"):
        _ = inteco_abs.disconnect


def test_too_little_has_no_card(stop, tmp_path):
    (tmp_path / "cut.mcap").write_bytes(stop.path.read_bytes()[:600])
    with pytest.raises(AbsError):
        _ = inteco_abs.open_session(tmp_path / "cut.mcap").card
