"""What a result is compared with: the latest of its kind that lies beside it."""

import os

import pytest

from inteco_abs.analysis import previous_card
from inteco_abs.mock_board import parse_faults


class Folder:
    """Runs one after the other, a second apart at any clock."""

    def __init__(self, path, run_at):
        self.path, self._run_at, self._count = path, run_at, 0

    def stop(self, *settings, name="", folder="", faults=()):
        self._count += 1
        (self.path / folder).mkdir(exist_ok=True)
        path = self.path / folder / (name or f"{self._count}.mcap")
        tiny = ("experiment.start_speed_rad_s=10.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0")
        card = self._run_at(path, (*tiny, "loop.rate_hz=200.0", *settings), faults=parse_faults(faults)).stop.card
        os.utime(path, (self._count, self._count))
        return card


@pytest.fixture
def folder(tmp_path, run_at):
    return Folder(tmp_path, run_at)


def before(card):
    found = previous_card(card)
    return found and os.path.basename(found["session"])  # noqa: PTH119  it is text


def test_it_is_the_latest_of_those_before(folder):
    assert before(folder.stop()) is None
    second, third = folder.stop(), folder.stop()
    assert (before(second), before(third)) == ("1.mcap", "2.mcap")


def test_with_a_changing_reference_nothing_is_comparable(folder):
    changing = ("controller.reference_points=[0.3, 0.1]", "controller.reference_at_s=[0.0, 1.0]")
    folder.stop(*changing)
    assert before(folder.stop(*changing)) is None


def test_its_card_is_whole_and_says_where_it_lies(folder):
    first = folder.stop()
    assert previous_card(folder.stop()) == first | {"differs": ""}
    assert previous_card(folder.stop("controller.gains.Mk=7.0"))["differs"] == "Mk 2.0 -> 7.0"


@pytest.mark.parametrize(
    "setting",
    [
        'estimator.name="kalman"',
        "experiment.start_speed_rad_s=11.0",
        *(
            pytest.param(setting, marks=pytest.mark.long)
            for setting in ('controller.name="relay"', 'simulation.rig="hard:1"', "controller.reference_slip=0.3")
        ),
    ],
)
def test_another_kind_is_passed_over(folder, setting):
    folder.stop()
    folder.stop(setting)
    assert before(folder.stop()) == "1.mcap"


@pytest.mark.long
def test_other_folders_and_what_is_not_a_whole_session_are_passed_over(folder):
    folder.stop()
    folder.stop(folder="elsewhere")
    (folder.path / "text.mcap").write_text("no session")
    (folder.path / "cut.mcap").write_bytes((folder.path / "1.mcap").read_bytes()[:-200])
    (folder.path / "gone.mcap").symlink_to("nowhere")
    for name in ("text.mcap", "cut.mcap"):
        os.utime(folder.path / name, (2, 2))
    assert before(folder.stop()) == "1.mcap"


@pytest.mark.long
def test_a_run_whose_board_was_made_to_fail_is_passed_over(folder):
    folder.stop()
    assert folder.stop(faults=["brake-weak=0.9@brake"])["outcome"] == "completed"
    assert before(folder.stop()) == "1.mcap"


@pytest.mark.long
def test_what_did_not_complete_is_compared_with_nothing(folder):
    first = folder.stop()
    assert before(folder.stop()) == "1.mcap"
    assert previous_card(folder.stop() | {"outcome": "interrupted"}) is None
    assert first["outcome"] == "completed"


def test_a_missing_session_has_no_previous_one(folder):
    card = folder.stop()
    assert previous_card(card | {"session": str(folder.path / "nowhere" / "1.mcap")}) is None
