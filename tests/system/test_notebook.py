"""What notebooks and scripts use: `import inteco_abs`."""

import io
import subprocess
import sys

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
    html = stop._repr_html_()  # the name that notebooks call
    assert html.count("<svg") == html.count("</svg>") == 1
    assert "<td>stop distance</td>" in html


def test_a_session_is_a_table_with_units(stop):
    frame = stop.to_pandas()
    assert frame["slip"].tolist() == stop.ticks["slip"].tolist()
    assert frame.attrs["units"]["torque_demand_nm"] == "N.m"
    assert stop.to_polars("truth").height == len(stop.truth)


def test_sessions_are_drawn_beside_one_another(stop, own, tmp_path):
    figure = stop.plot(own, width="one")
    assert [axis.get_ylabel().split(" ")[0] for axis in figure.axes[:3]] == ["speed", "slip,", "brake"]
    figure.savefig(tmp_path / "both.png")
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


def test_a_session_replays(stop, own):
    assert stop.replay().differing == 0
    assert own.replay(Bang).differing == 0
    with pytest.raises(SessionError, match="no controller 'Bang'"):
        own.replay()


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
        (lambda: inteco_abs.connect("usb2:77").run_stop(out="never.mcap"), BoardError, "77"),
        (lambda: inteco_abs.open_session("missing.mcap"), SessionError, "No such file"),
        (lambda: inteco_abs.open_session(__file__), SessionError, "not an MCAP file"),
    ],
)
def test_mistakes_are_reported_as_by_the_command(wrong, error, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=words):
        wrong()
    assert not list(tmp_path.rglob("*.mcap"))


def test_the_command_starts_without_what_notebooks_need():
    script = "import sys, inteco_abs; print([name for name in ('numpy', 'inteco_abs.notebook') if name in sys.modules])"
    report = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert report == "[]\n"
    with pytest.raises(AttributeError, match="no attribute 'disconnect'"):
        _ = inteco_abs.disconnect


def test_too_little_has_no_card(stop, tmp_path):
    (tmp_path / "cut.mcap").write_bytes(stop.path.read_bytes()[:600])
    with pytest.raises(AbsError):
        _ = inteco_abs.open_session(tmp_path / "cut.mcap").card
