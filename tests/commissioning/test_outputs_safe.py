"""What may be written when, and that nothing stays on."""

import os
import signal

import pytest

from inteco_abs.boards import STILL_ON, check_limits
from inteco_abs.commissioning import ProfileDraft
from inteco_abs.commissioning.permission import outputs_permitted
from inteco_abs.commissioning.step import StepContext
from inteco_abs.config import load_config
from inteco_abs.errors import CommissioningError, LinkError, ReadOnlyError, UnsafeError

READING = ["list", "header", "reads", "wheels"]


def energised(settings):
    return settings.get("pwm0_width", 0) or settings.get("pwm1_width", 0)


def test_steps_one_to_four_write_only_read_requests(lab, scripts):
    procedure = lab.session(*(answer for name in READING for answer in scripts[name]))
    for name in READING:
        procedure.go(only=name)
    assert len(lab.rig.written) > 1000
    assert lab.rig.frames_sent == []


@pytest.mark.long
def test_they_do_so_even_with_a_signed_draft(lab, scripts):
    lab.all_done()
    procedure = lab.session(*(answer for name in READING for answer in scripts[name]))
    for name in READING:
        procedure.go(only=name)
    assert lab.rig.frames_sent == []


@pytest.mark.parametrize("step", ["echo", "motors"])
@pytest.mark.parametrize("answer", ["", "yes", "the power interface is on", "the cover is closed"])
def test_without_the_phrase_nothing_is_written(lab, step, answer):
    lab.done_until(step)
    with pytest.raises(CommissioningError, match="nothing was written"):
        lab.session("", answer).go(only=step)
    assert lab.rig.written == []
    assert lab.outcomes()[step] == "failed"


@pytest.mark.parametrize("step", ["echo", pytest.param("motors", marks=pytest.mark.long)])
def test_the_phrase_is_taken_in_any_case_and_spacing(lab, scripts, step):
    lab.done_until(step)
    lab.session("", scripts[step][1].upper().replace(" ", "  "), *scripts[step][2:]).go(only=step)
    assert lab.outcomes()[step] == "done"


@pytest.mark.parametrize("step", ["echo", "motors", "sign"])
def test_a_read_only_profile_is_never_driven_nor_signed(lab, scripts, step):
    lab.done_until(step)
    procedure = lab.session(*scripts[step], settings=['board.read_only="another rig"'])
    with pytest.raises(ReadOnlyError, match="another rig"):
        procedure.go(only=step)
    assert lab.operator.asked == ["Begin? Press Enter, or type stop."]
    assert lab.rig.written == []


def test_the_typed_confirmation_never_gets_into_the_draft(lab):
    lab.done_until("sign")
    text = lab.file.read_text() + lab.draft.results_file.read_text()
    assert "verified_by" not in text
    assert "typed confirmation" not in text


@pytest.mark.parametrize("step", ["echo", "motors"])
def test_the_first_and_the_last_thing_written_are_safe(lab, scripts, step):
    lab.done_until(step)
    lab.session(*scripts[step]).go(only=step)
    sent = lab.rig.settings_sent
    assert not energised(sent[0])
    assert not energised(sent[-1])
    assert any(energised(settings) for settings in sent)


def test_the_echo_test_moves_nothing_and_its_duties_are_small(lab, scripts):
    lab.done_until("echo")
    lab.session(*scripts["echo"]).go(only="echo")
    for settings in lab.rig.settings_sent:
        full = 4095 if settings["pwm0_mode"] else 255
        assert settings["pwm0_width"] <= 0.11 * full
        assert settings["pwm1_width"] <= 0.21 * full
    assert lab.rig.largest == (0.0, 0.0)


def test_the_echo_test_leaves_the_profiles_own_settings(lab, scripts):
    lab.done_until("echo")
    lab.session(*scripts["echo"], settings=[]).go(only="echo")
    last = lab.rig.settings_sent[-1]
    assert (last["pwm0_mode"], last["pwm0_prescaler"], last["pwm1_mode"], last["pwm1_prescaler"]) == (0, 44, 0, 44)
    tried = {(one["pwm0_mode"], one["pwm1_prescaler"]) for one in lab.rig.settings_sent}
    assert tried == {(0, 44), (1, 2)}


def test_motors_are_driven_gently(lab, scripts):
    lab.done_until("motors")
    lab.session(*scripts["motors"]).go(only="motors")
    assert lab.rig.largest[0] <= 0.2
    assert lab.rig.largest[1] <= 0.5


@pytest.mark.parametrize("step", ["echo", "motors"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGTSTP])
def test_a_signal_while_outputs_are_on_ends_in_safe(lab, scripts, step, number):
    lab.done_until(step)
    procedure = lab.session(*scripts[step])

    def strike(_number):
        frames = lab.rig.settings_sent
        if frames and energised(frames[-1]) and not faulted:
            faulted.append(len(frames))
            os.kill(os.getpid(), number)

    faulted = []
    lab.rig.before_write = strike
    with pytest.raises(KeyboardInterrupt):
        procedure.go(only=step)
    assert not energised(lab.rig.settings_sent[-1])
    assert len(lab.rig.frames_sent) <= faulted[0] + 5
    assert lab.rig.device.duties == (0.0, 0.0)
    assert lab.outcomes()[step] == "open"
    assert lab.draft.config.board.verified_by == ""


@pytest.mark.parametrize("step", ["echo", "motors"])
def test_a_link_that_fails_for_a_while_ends_in_safe(lab, scripts, step):
    lab.done_until(step)
    procedure = lab.session(*scripts[step])
    failed = []

    def fail(_number):
        frames = lab.rig.settings_sent
        if len(failed) < 8 and len(frames) > 20 and energised(frames[-2]):
            failed.append(True)
            raise LinkError("the cable is loose")

    lab.rig.before_write = fail
    with pytest.raises(CommissioningError, match="too many exchanges"):
        procedure.go(only=step)
    assert lab.rig.device.duties == (0.0, 0.0)


@pytest.mark.parametrize("step", ["echo", "motors"])
def test_safe_that_cannot_be_confirmed_is_said_with_its_own_exit_code(lab, scripts, step):
    lab.done_until(step)
    procedure = lab.session(*scripts[step])

    def fail(_number):
        if len(lab.rig.frames_sent) > 20:
            raise LinkError("the cable is off")

    lab.rig.before_write = fail
    with pytest.raises(UnsafeError) as error:
        procedure.go(only=step)
    assert error.value.exit_code == 5
    assert STILL_ON in str(error.value)


def test_outputs_left_on_by_another_program_are_reported_and_left_alone(lab):
    lab.session("", "", "", "")
    lab.rig.change_answer = lambda answer: answer[:44] + b"\xff\x00" + answer[46:]  # width of PWM 0
    with pytest.raises(CommissioningError, match="emergency switch"):
        lab.procedure.go()
    assert lab.operator.heard("THE PWM OUTPUTS ARE NOT ZERO")
    assert lab.outcomes()["wheels"] == "failed"
    assert lab.rig.frames_sent == []


@pytest.mark.parametrize("profile", ["usb2_generic_0103", "usb1_0111", "usb1_abs_candidate", "pci_abs_50f"])
def test_what_is_permitted_is_within_a_real_boards_ceilings(lab, profile):
    kind = load_config(profile=profile).board.kind
    lab.session("the phrase")
    draft = ProfileDraft.open(lab.file.with_name("real.toml"), f"{kind}:", profile)
    draft.record("header", {"outcome": "done", "logic_version": "0x0111"})
    permitted = outputs_permitted(StepContext(lab.rig, draft, lab.operator), "", "the phrase")
    check_limits(f"{kind}:", permitted)
