"""The draft's two files."""

import json

import pytest

from inteco_abs.commissioning import ProfileDraft
from inteco_abs.config import load_config
from inteco_abs.errors import ConfigError


def test_a_new_draft_can_be_used_at_once_and_is_unsigned(lab):
    lab.session(profile="sim_usb2")
    config = load_config(profile=str(lab.file))
    assert config.board.numbering_pwm == 7
    assert config.board.verified_by == ""


def test_the_logic_is_written_in_hex(lab):
    lab.session()
    assert "logic_version = 0x0103" in lab.file.read_text()


@pytest.mark.long
def test_the_draft_can_be_used_after_every_write(lab, whole_script, monkeypatch):
    procedure = lab.session(*whole_script)
    seen = []
    record = lab.draft.record

    def found(step, result):
        record(step, result)
        seen.append((step, load_config(profile=str(lab.file)).board.verified_by))

    monkeypatch.setattr(lab.draft, "record", found)
    procedure.go()
    assert [step for step, _ in seen] == ["list", "header", "reads", "wheels", "echo", "motors", "sign"]
    assert [by for _, by in seen] == [""] * 6 + ["the lab"]


def test_a_value_that_no_run_could_use_does_not_get_into_the_file(lab):
    lab.session()
    before = lab.file.read_text()
    with pytest.raises(ConfigError, match="another encoder"):
        lab.draft.write({"board.wheel_encoder": 0})
    assert lab.file.read_text() == before
    lab.draft.write({"board.wheel_encoder": 2})
    assert load_config(profile=str(lab.file)).board.wheel_encoder == 2


@pytest.mark.parametrize("setting", ["board.verified_by=lab", "board.verified_on=2026-01-01", "board.verified_logic=1"])
def test_a_signature_is_not_set_from_outside(lab, setting):
    with pytest.raises(ConfigError, match="last step"):
        lab.session(settings=[setting])
    assert not lab.file.exists()


def test_a_wrong_setting_is_refused_and_nothing_is_written(lab):
    with pytest.raises(ConfigError, match="at most 7"):
        lab.session(settings=["board.drive_pwm=9"])
    assert not lab.file.exists()


def test_the_profile_of_a_draft_cannot_be_changed_in_passing(lab):
    lab.session()
    with pytest.raises(ConfigError, match="was begun from usb2_generic_0103"):
        ProfileDraft.open(lab.file, "sim:", "usb1_0111", given=True)


def test_a_draft_belongs_to_one_kind_of_board(lab):
    lab.session()
    with pytest.raises(ConfigError, match="begun with the board sim:"):
        ProfileDraft.open(lab.file, "usb2:7", "usb2_generic_0103")


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"schema_version": 2}', '{"schema_version": 1, "board": "", "profile": "", "steps": {"list": 3}}'],
)
def test_results_that_the_walk_did_not_write_are_refused(lab, text):
    lab.session()
    lab.draft.results_file.write_text(text)
    with pytest.raises(ConfigError, match="delete it"):
        lab.session()


def test_without_its_results_a_draft_begins_again_as_it_is(lab):
    lab.done_until("echo")
    lab.draft.results_file.unlink()
    lab.session()
    assert set(lab.outcomes().values()) == {"open"}
    assert lab.draft.config.board.application_names == ["ABSSIM"]


def test_a_draft_edited_into_nonsense_is_refused_with_its_key(lab):
    lab.session()
    lab.file.write_text("[board]\ndrive_pwm = 'x'\n")
    with pytest.raises(ConfigError, match=r"board\.drive_pwm"):
        lab.session()


def test_results_are_kept_beside_the_draft(lab):
    lab.all_done()
    kept = json.loads((lab.file.parent / "lab.results.json").read_text())
    assert kept["steps"]["header"]["raw"].startswith("0301")
    assert kept["steps"]["motors"]["brake_from"] == pytest.approx(0.415, abs=0.03)
    assert kept["steps"]["wheels"]["road"]["turned"] == 40960


def test_results_under_their_earlier_name_are_read(lab):
    lab.done_until("reads")
    lab.draft.results_file.rename(lab.file.with_suffix(".probe.json"))
    lab.session()
    assert lab.outcomes()["header"] == "done"


@pytest.mark.long
def test_no_other_file_is_left(lab, whole_script):
    lab.session(*whole_script).go()
    assert sorted(file.name for file in lab.file.parent.iterdir()) == ["lab.results.json", "lab.toml"]
