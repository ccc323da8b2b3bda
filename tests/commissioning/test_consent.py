"""Before the first write the operator sees what it would change, word by word, and may say no."""

import pytest

from firmware_protocol.rtdac_usb2 import LOGICS, READ_REQUEST, encode_send
from inteco_abs.errors import CommissioningError, Stopped

ROWS = (
    "   w10  0x0000 -> 0x0024    pin_mode",
    "   w20  0x0000 -> 0x002C    pwm0_prescaler",
    "   w23  0x0000 -> 0x002C    pwm1_prescaler",
)


def test_table_precedes_the_question_and_the_question_the_first_write(lab, scripts):
    lab.done_until("echo")
    seen = []

    def answer():
        assert lab.rig.frames_sent == []
        seen.extend(lab.operator.said)
        return "yes"

    lab.session(*scripts["echo"][:-1], answer).go(only="echo")
    (table,) = [stated for stated in seen if "change with the first write" in stated]
    assert all(row in table for row in ROWS)
    assert lab.operator.asked[-1].startswith("Write this to the board?")
    assert lab.rig.frames_sent
    first = lab.draft.results["echo"]["first_write"]
    assert {"place": "w20", "names": ["pwm0_prescaler"], "now": 0, "planned": 44, "remark": ""} in first


def test_no_means_that_nothing_is_written(lab, scripts):
    lab.done_until("echo")
    with pytest.raises(Stopped, match="nothing was written"):
        lab.session(*scripts["echo"][:-1], "no").go(only="echo")
    assert set(lab.rig.written) == {READ_REQUEST}
    assert lab.outcomes()["echo"] == "open"


@pytest.mark.long
def test_what_has_been_agreed_to_is_shown_again_and_not_asked_again(lab, scripts):
    lab.done_until("motors")
    lab.session(*scripts["motors"]).go(only="motors")
    assert lab.operator.heard("change with the first write")
    assert not any("Write this" in question for question in lab.operator.asked)


def test_a_board_that_has_changed_since_is_asked_about_again(lab, scripts):
    lab.done_until("motors")
    procedure = lab.session(*scripts["motors"][:2], "no")
    lab.rig.device.settings |= {"pin_mode": 1}
    lab.rig.link().write(encode_send({"pin_mode": 1, "pwm0_prescaler": 9}))
    before = lab.rig.frames_sent
    with pytest.raises(Stopped):
        procedure.go(only="motors")
    assert lab.operator.heard("0x0009 -> 0x002C")
    assert lab.rig.frames_sent == before


@pytest.mark.parametrize("step", ["echo", "motors"])
def test_a_pwm_that_is_not_the_profile_s_own_may_not_run(lab, scripts, step):
    lab.done_until(step)
    procedure = lab.session(*scripts[step])
    lab.rig.link().write(encode_send({"pwm4_width": 100}))
    before = lab.rig.frames_sent
    with pytest.raises(CommissioningError, match=r"pwm4_width.*pwm4_width = 0"):
        procedure.go(only=step)
    assert lab.rig.frames_sent == before


def test_unless_the_profile_sets_it_off(lab, scripts):
    settings = ["board.constants.pwm4_width=0"]
    lab.done_until("echo", settings)
    procedure = lab.session(*scripts["echo"])
    lab.rig.link().write(encode_send({"pwm4_width": 100}))
    procedure.go(only="echo")
    assert lab.operator.heard("0x0064 -> 0x0000    pwm4_width")
    assert {sent["pwm4_width"] for sent in lab.rig.settings_sent[1:]} == {0}


@pytest.mark.long
def test_commissioning_an_unknown_abs_logic_turns_thermal_protection_on(lab, whole_script):
    lab.session(*whole_script, profile="usb2_abs_candidate").go(only="list")
    lab.operator.answers[:] = ["", "no", *whole_script[2:]]  # the mock's version is the generic logic's
    lab.procedure.go()
    assert lab.operator.heard("w31  0x0000 -> 0x0003    pwm_thermal_flags")
    assert lab.draft.config.board.verified_by == "the lab"
    decode = LOGICS["abs"].send.decode
    assert {decode(frame)["pwm_thermal_flags"] for frame in lab.rig.frames_sent} == {3}
