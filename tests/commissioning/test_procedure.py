"""The whole procedure: order, resuming, what it keeps."""

import json
from dataclasses import asdict

import pytest

from inteco_abs.boards import Board, unconfirmed
from inteco_abs.commissioning import MockRigAccess, PacedMockRigAccess
from inteco_abs.config import load_config
from inteco_abs.errors import AnswerError, CommissioningError, ConfigError, Stopped
from inteco_abs.experiment import manual_control

STEPS = ["list", "header", "reads", "wheels", "echo", "motors", "sign"]


def wiring(config):
    board = config.board
    return (
        board.drive_pwm,
        board.brake_pwm,
        board.road_encoder,
        board.wheel_encoder,
        board.road_sign,
        board.wheel_sign,
        config.encoders.counts_per_turn,
    )


@pytest.mark.long
def test_a_vendors_rig_is_commissioned_from_end_to_end(lab, whole_script):
    lab.session(*whole_script).go()
    config = load_config(profile=str(lab.file))
    assert wiring(config) == (0, 1, 0, 1, 1, 1, 4096)
    assert config.board.verified_by == "the lab"
    assert config.board.verified_logic == 0x0103
    assert config.board.application_names == ["ABSSIM"]
    assert unconfirmed(config.board) == ["numbering_pwm (inferred)"]
    assert lab.operator.answers == []
    assert lab.rig.device.duties == (0.0, 0.0)


@pytest.mark.long
def test_an_odd_rig_is_found_out(lab, scripts, odd):
    lab.session(
        *[""] * 3,
        *["", "", "yes", "10", "", "10"],
        *scripts["echo"],
        *scripts["motors"],
        *scripts["sign"],
        settings=[*odd, "board.drive_pwm=1", "board.brake_pwm=0"],
    ).go()
    config = load_config(profile=str(lab.file))
    assert wiring(config) == (1, 0, 5, 2, 1, -1, 2048)
    assert config.board.verified_by == "the lab"


def test_a_signed_draft_opens_the_board_for_output(lab):
    lab.all_done()
    board: Board
    with lab.rig.open(load_config(profile=str(lab.file))) as board:
        assert not board.identity.read_only_because


def test_the_unsigned_draft_opens_it_for_reading_only(lab):
    lab.done_until("sign")
    with lab.rig.open(load_config(profile=str(lab.file))) as board:
        assert "was not verified" in board.identity.read_only_because


@pytest.mark.parametrize(
    "step", [each if each in {"motors", "sign"} else pytest.param(each, marks=pytest.mark.long) for each in STEPS]
)
def test_interrupted_procedure_keeps_the_draft_and_continues_there(lab, scripts, step):
    lab.done_until(step)
    before = lab.file.read_text() if lab.file.exists() else ""
    with pytest.raises(KeyboardInterrupt):
        lab.session(*scripts[step][:-1], KeyboardInterrupt()).go()
    assert before in ("", lab.file.read_text())
    assert lab.rig.device.duties == (0.0, 0.0)
    rest = STEPS[STEPS.index(step) :]
    lab.session(*(answer for name in rest for answer in scripts[name])).go()
    assert set(lab.outcomes().values()) == {"done"}


@pytest.mark.parametrize("step", STEPS)
def test_typing_stop_leaves(lab, step):
    lab.done_until(step)
    with pytest.raises(Stopped) as left:
        lab.session("stop").go()
    assert left.value.exit_code == 130
    assert lab.outcomes()[step] == "open"


@pytest.mark.parametrize("step", STEPS)
def test_an_answer_that_is_not_just_enter_begins_no_step(lab, step):
    lab.done_until(step)
    with pytest.raises(CommissioningError, match="no valid answer"):
        lab.session("go", "yes", "ok").go()
    assert lab.outcomes()[step] == "failed"
    assert lab.rig.written == []


def test_a_quiet_visit_asks_nothing_and_ends_before_the_hands_are_needed(lab):
    lab.session(quiet=True).go()
    assert lab.outcomes() == dict.fromkeys(STEPS[:3], "done") | dict.fromkeys(STEPS[3:], "open")
    assert lab.operator.asked == []


def test_a_step_whose_turn_has_not_come_is_refused(lab):
    with pytest.raises(ConfigError, match="motors comes after list, which is open"):
        lab.session().go(only="motors")


def test_a_step_may_be_named_by_its_number(lab):
    lab.session("").go(only="1")
    assert lab.outcomes()["list"] == "done"


@pytest.mark.parametrize("name", ["moters", "8", "0"])
def test_a_step_that_does_not_exist_is_refused(lab, name):
    with pytest.raises(ConfigError, match="no step"):
        lab.session().go(redo=name)


def test_a_step_done_again_with_the_same_result_leaves_the_later_ones_alone(lab, scripts):
    lab.all_done()
    lab.session(*scripts["wheels"]).go(redo="wheels")
    assert set(lab.outcomes().values()) == {"done"}


def test_a_changed_wiring_takes_the_signature_and_what_rests_on_it(lab):
    lab.all_done()
    lab.session(settings=["board.brake_pwm=3"])
    assert lab.draft.config.board.verified_by == ""
    assert lab.outcomes() == {name: "outdated" if name in STEPS[4:] else "done" for name in STEPS}


def test_settings_outside_the_wiring_keep_the_sign_off(lab):
    lab.all_done()
    lab.session(settings=["experiment.start_speed_rad_s=100"])
    assert lab.draft.config.board.verified_by == "the lab"


def test_the_guards_limits_are_shown_and_signed_with_the_wiring(lab, scripts):
    lab.done_until("sign")
    lab.session(*scripts["sign"]).go()
    limits = load_config(profile=str(lab.file)).guard
    for key, value in asdict(limits).items():
        assert f"{key} = {value}" in lab.file.read_text()
    assert any(f"signed off with it: guard brake_limit {limits.brake_limit:g}" in text for text in lab.operator.said)


@pytest.mark.parametrize(("change", "by"), [(1, ""), (-1, "the lab")])
def test_raised_limit_voids_the_sign_off_and_a_lowered_one_does_not(lab, change, by):
    lab.all_done()
    most = lab.draft.config.guard.missed_in_a_row
    lab.session(settings=[f"guard.missed_in_a_row={most + change}"])
    assert lab.draft.config.board.verified_by == by
    assert lab.outcomes()["sign"] == ("done" if by else "outdated")


def test_a_wiring_edited_by_hand_is_noticed(lab):
    lab.all_done()
    lab.file.write_text(lab.file.read_text().replace("wheel_encoder = 1", "wheel_encoder = 3"))
    lab.session()
    assert lab.outcomes()["wheels"] == "outdated"
    assert lab.outcomes()["sign"] == "outdated"


def test_a_step_that_failed_says_what_to_do(lab, monkeypatch):
    lab.done_until("echo")

    def refuse(*_arguments, **_more):
        raise CommissioningError("a wheel moved")

    monkeypatch.setattr("inteco_abs.commissioning.pwm_echo.agree_on_first_write", refuse)
    with pytest.raises(CommissioningError) as failure:
        lab.session("", "the power interface is off").go()
    assert "step 5 (echo) failed. What to do: the profile's PWM words" in failure.value.__notes__[0]
    kept = json.loads(lab.draft.results_file.read_text())["steps"]["echo"]
    assert kept["outcome"] == "failed"
    assert "a wheel moved" in kept["problem"]


@pytest.mark.parametrize("typed", ["", "the powre interface is off"])
def test_a_mistyped_phrase_blames_no_profile(lab, typed):
    lab.done_until("echo")
    with pytest.raises(AnswerError) as failure:
        lab.session("", typed).go()
    assert "What to do: the same command asks again" in failure.value.__notes__[0]


class StoppedClock:
    """Real time, for the rig."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept_s: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.now_s += seconds


class TestTimeOfTheMock:
    @pytest.fixture
    def clock(self, monkeypatch):
        clock = StoppedClock()
        monkeypatch.setattr("inteco_abs.commissioning.mock_rig_access.time", clock)
        return clock

    def test_virtual_time_waits_for_nothing(self, clock):
        rig = MockRigAccess(load_config())
        rig.pause(5.0)
        assert (rig.now_ns(), clock.slept_s) == (5_000_000_000, [])

    def test_otherwise_it_is_never_ahead_of_real_time(self, clock):
        rig = PacedMockRigAccess(load_config(), manual_control)
        rig.pause(0.5)
        clock.now_s += 0.2  # something else took a while
        rig.pause(0.5)
        rig.pause(0.5)
        assert clock.slept_s[-2:] == pytest.approx([0.3, 0.5])
        assert rig.now_ns() == 1_500_000_000

    def test_a_long_question_is_not_made_up_for(self, clock):
        rig = PacedMockRigAccess(load_config(), manual_control)
        rig.pause(0.5)
        clock.now_s += 60.0
        rig.pause(0.5)
        rig.pause(0.5)
        assert clock.slept_s[-1] == pytest.approx(0.5)


class TestSigning:
    @pytest.mark.parametrize("name", ["", "  ", "123", "x" * 101, "tab\tbed"])
    def test_what_is_not_a_name_does_not_sign(self, lab, name):
        lab.done_until("sign")
        with pytest.raises(CommissioningError, match="no valid answer"):
            lab.session("", name, name, name).go()
        assert lab.draft.config.board.verified_by == ""

    def test_without_a_confirmed_name_there_is_no_sign_off(self, lab):
        lab.done_until("sign")
        with pytest.raises(Stopped, match="not signed"):
            lab.session("", "the lab", "no").go()
        assert lab.draft.config.board.verified_by == ""
        assert lab.outcomes()["sign"] == "open"

    def test_what_is_not_confirmed_is_shown_before(self, lab, scripts):
        lab.done_until("sign")
        lab.session(*scripts["sign"]).go()
        stated = next(text for text in lab.operator.said if "not confirmed" in text)
        assert "numbering_pwm (inferred): eight channels" in stated
