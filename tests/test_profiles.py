"""Shipped profiles: what they know, what they admit not to know, and whose word outputs rest on."""

from datetime import date

import pytest

from inteco_abs.boards import (
    InProcessLink,
    board_behind,
    check_kind,
    check_limits,
    default_profile,
    kind_check,
    schemes,
    unconfirmed,
)
from inteco_abs.config import WIRING, BoardConfig, Evidence, load_config, parse_config, profiles
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import Device, front_end_of

REAL = [name for name in profiles() if not name.startswith("sim_")]
LAB = """
[board]
logic_version = 0x0103
application_names = ["ABSSIM"]
verified_by = "A. Lab"
verified_on = 2026-03-04
verified_logic = {signed_logic}
"""


def opened(config):
    device = Device(load_config(), lambda: 0)
    board = board_behind(InProcessLink(front_end_of(device)), config, lambda: 0)
    with board:
        return board.identity


@pytest.fixture
def lab(tmp_path):
    """Maker of a lab's signed profile."""

    def write(*settings, signed_logic="0x0103", over=""):
        file = tmp_path / "lab.toml"
        file.write_text(LAB.format(signed_logic=signed_logic), encoding="utf-8")
        rig = tmp_path / "rig.toml"
        rig.write_text(f'profile = "{file}"\n{over}', encoding="utf-8")
        return load_config(rig, settings)

    return write


def test_the_profiles_for_every_board_are_shipped():
    assert set(profiles()) == {
        "open_board",
        "pci_abs_50f",
        "sim_open",
        "sim_pci",
        "sim_usb",
        "sim_usb2",
        "usb1_0111",
        "usb1_0112",
        "usb1_abs_candidate",
        "usb2_abs_candidate",
        "usb2_generic_0103",
        "usb2_tras",
    }


@pytest.mark.parametrize("name", profiles())
def test_a_profile_is_whole_and_survives_its_own_text(name):
    config = load_config(settings=[f"profile={name}"])
    assert parse_config(config.to_toml()) == config


@pytest.mark.parametrize("name", REAL)
def test_no_profile_of_a_real_board_is_signed(name):
    board = load_config(settings=[f"profile={name}"]).board
    assert board.verified_by == ""
    assert unconfirmed(board)


@pytest.mark.parametrize("name", [name for name in REAL if name != "usb2_tras"])
def test_every_key_that_outputs_rest_on_has_a_status_and_a_source(name):
    board = load_config(settings=[f"profile={name}"]).board
    for key, evidence in board.evidence.items():
        assert evidence.source, key
    unused = {"numbering_pwm", "timer", "watchdog_pin", "watchdog_contact_pin"}
    relied_on = {*WIRING} - {"numbering_pins"} - {key for key in unused if getattr(board, key) < 0}
    relied_on -= {"pwm_pins", "pwm_functions"} if board.kind in {"open", "pci"} else set()
    relied_on -= {"pwm_functions"} if board.pwm_functions is None else set()
    relied_on -= set() if board.kind == "usb2" else {"frame_map"}
    relied_on -= set() if board.constants else {"constants"}
    assert set(board.evidence) == relied_on


@pytest.mark.parametrize("scheme", schemes())
def test_every_scheme_begins_with_a_profile_of_its_own_kind(scheme):
    check_kind(f"{scheme}:", load_config(profile=default_profile(f"{scheme}:")))


def test_a_profile_for_another_board_family_than_the_address_is_refused():
    with pytest.raises(ConfigError) as refusal:
        check_kind("pci:", load_config())
    assert "usb2" in str(refusal.value)
    assert "pci:" in str(refusal.value)


def test_a_profile_made_for_the_mock_opens_no_real_pci_board():
    with pytest.raises(ConfigError, match=r"board\.simulated: the profile was made for the mock"):
        check_kind("pci:", load_config(profile="sim_pci"))
    check_kind("sim:", load_config(profile="sim_pci"))


class TestSignature:
    def test_a_signed_profile_may_drive(self, lab):
        assert opened(lab()).read_only_because == ""

    def test_a_signature_for_another_logic_may_not(self, lab):
        because = opened(lab(signed_logic="0x0102")).read_only_because
        assert "A. Lab" in because
        assert "0x0102" in because

    @pytest.mark.parametrize("key", ["verified_on", "verified_logic"])
    def test_a_signature_needs_day_and_logic(self, tmp_path, key):
        file = tmp_path / "lab.toml"
        text = LAB.format(signed_logic="0x0103")
        file.write_text("\n".join(line for line in text.splitlines() if not line.startswith(key)), encoding="utf-8")
        with pytest.raises(ConfigError, match=rf"board.verified_by \(.*line 5\): a sign-off needs board.{key}"):
            load_config(settings=[f"profile={file}"])

    @pytest.mark.parametrize(
        ("setting", "key"),
        [
            ("board.road_sign=-1", "road_sign"),
            ("board.drive_pwm=2", "drive_pwm"),
            ("board.pwm_mode=12-bit", "pwm_mode"),
            ("board.frame_map=servo", "frame_map"),
            ("board.constants.pwm4_width=0", "constants"),
            ("encoders.counts_per_turn=1024", "counts_per_turn"),
        ],
    )
    def test_wiring_that_is_changed_over_a_signed_profile_opens_read_only(self, lab, setting, key):
        because = opened(lab(setting)).read_only_because
        assert key in because
        assert "A. Lab" in because

    @pytest.mark.parametrize("setting", ["board.road_sign=1", "guard.brake_limit=0.5", "loop.rate_hz=500"])
    def test_the_same_wiring_and_other_keys_leave_the_signature_alone(self, lab, setting):
        assert opened(lab(setting)).read_only_because == ""

    def test_changed_wiring_can_be_signed_where_it_is_changed(self, lab):
        over = '[board]\nroad_sign = -1\nverified_by = "B. Lab"\n'
        assert opened(lab(over=over)).read_only_because == ""

    def test_a_setting_over_a_signed_file_is_found_also_if_the_file_is_not_a_profile(self, tmp_path):
        file = tmp_path / "lab.toml"
        file.write_text(LAB.format(signed_logic="0x0103"), encoding="utf-8")
        because = opened(load_config(file, ["board.drive_pwm=3"], profile="usb2_generic_0103")).read_only_because
        assert "drive_pwm" in because
        assert "A. Lab" in because

    @pytest.mark.parametrize(
        "settings",
        [
            ["board.logic_version=0x0222", "board.verified_logic=0x0222"],
            ["board.application_names=['ABSSIM', 'ABS2']"],
            ["board.verified_on=2027-01-01"],
        ],
    )
    def test_a_sign_off_is_not_valid_for_another_logic_name_or_day(self, lab, settings):
        assert "A. Lab" in lab(*settings).board.read_only

    def test_a_read_only_reason_cannot_be_removed_under_a_sign_off(self, tmp_path):
        file = tmp_path / "lab.toml"
        text = LAB.format(signed_logic="0x0103") + 'read_only = "the brake is dismantled"\n'
        file.write_text(text, encoding="utf-8")
        because = opened(load_config(settings=[f"profile={file}", 'board.read_only=""'])).read_only_because
        assert "read_only" in because

    def test_the_day_is_kept(self, lab):
        assert parse_config(lab().to_toml()).board.verified_on == date(2026, 3, 4)


class TestLimits:
    """Limits of the guard: a sign-off covers them, and on a real board they have ceilings."""

    SIGNED = "silence_s = 0.08\nmissed_in_a_row = 10\n"

    @pytest.fixture
    def signed(self, tmp_path):
        """A profile that was signed with its own limits, and a configuration over it."""

        def load(*settings, over=""):
            file, rig = tmp_path / "lab.toml", tmp_path / "rig.toml"
            file.write_text(f"{LAB.format(signed_logic='0x0103')}\n[guard]\n{self.SIGNED}", encoding="utf-8")
            rig.write_text(f"profile = {str(file)!r}\n{over}", encoding="utf-8")
            return load_config(rig, settings)

        return load

    @pytest.mark.parametrize(
        "setting",
        ["guard.silence_s=0.08", "guard.silence_s=0.05", "guard.missed_in_a_row=2", "guard.brake_limit=0.1",
         "guard.over_speed_rad_s=200", "guard.run_up_factor=1.2"],
    )  # fmt: skip
    def test_what_was_signed_and_what_is_more_careful_leave_the_signature_alone(self, signed, setting):
        config = signed(setting)
        assert opened(config).read_only_because == ""
        check_limits("usb2:", config)
        check_limits("usb2:", signed(over=f"[guard]\n{setting.removeprefix('guard.')}\n"))

    @pytest.mark.parametrize(
        ("setting", "because"),
        [
            ("guard.silence_s=0.09", "guard.silence_s at most 0.08, and 0.09 is requested"),
            ("guard.missed_in_a_row=11", "guard.missed_in_a_row at most 10, and 11 is requested"),
            ("guard.bucket_limit=31", "guard.bucket_limit at most 30, and 31 is requested"),
            ("guard.brake_limit=0.75", "guard.brake_limit at most 0.7, and 0.75 is requested"),
            ("guard.run_up_factor=1.6", "guard.run_up_factor at most 1.5, and 1.6 is requested"),
        ],
    )
    def test_more_than_was_signed_opens_read_only_wherever_it_is_requested(self, signed, setting, because):
        for config in (signed(setting), signed(over=f"[guard]\n{setting.removeprefix('guard.')}\n")):
            found = opened(config).read_only_because
            assert found == f"A. Lab signed the profile with {because}. Lower it, or sign the profile again"

    def test_a_limit_that_was_lowered_in_the_file_may_be_raised_to_what_was_signed(self, signed):
        assert opened(signed("guard.silence_s=0.08", over="[guard]\nsilence_s = 0.05\n")).read_only_because == ""

    def test_a_higher_limit_can_be_signed_off_on_request(self, signed):
        over = '[board]\nverified_by = "B. Lab"\n[guard]\nsilence_s = 0.1\n'
        assert opened(signed(over=over)).read_only_because == ""
        beyond = signed("guard.missed_in_a_row=20", over=over).board.read_only
        assert beyond.startswith("B. Lab signed the profile with guard.missed_in_a_row at most 10")

    CEILINGS = (
        (2000.0, "missed_in_a_row", 50, 51),
        (250.0, "missed_in_a_row", 6, 7),
        (50.0, "missed_in_a_row", 4, 5),
        (2000.0, "bucket_limit", 300, 301),
        (250.0, "bucket_limit", 37, 38),
        (50.0, "bucket_limit", 30, 31),
        (2000.0, "silence_s", 0.1, 0.11),
        (2000.0, "run_up_factor", 2.0, 2.01),
    )

    @pytest.mark.parametrize(("rate_hz", "key", "most", "beyond"), CEILINGS)
    def test_a_ceiling_holds_on_a_real_board_with_any_signature(self, lab, rate_hz, key, most, beyond):
        def config(value):
            over = f"[board]\nverified_by = 'B. Lab'\n[guard]\n{key} = {value}\n"
            return lab(f"loop.rate_hz={rate_hz}", "estimator.window_s=0.05", over=over)

        check_limits("usb2:", config(most))
        with pytest.raises(ConfigError, match=rf"guard\.{key}: {beyond}: on a real board at most {most:g}"):
            check_limits("usb2:", config(beyond))
        check_limits("sim:", config(beyond))

    def test_more_than_the_default_takes_a_signature(self):
        asked = ["profile=usb2_generic_0103", "guard.silence_s=0.08", "guard.brake_limit=0.8"]
        with pytest.raises(ConfigError) as refused:
            check_limits("usb2:", load_config(settings=asked))
        found = {one.path: one.problem for one in refused.value.mistakes}
        signs = ": more needs a signed profile; sign one with inteco-abs commission"
        assert found == {
            "guard.silence_s": f"at most 0.05, and 0.08 is requested{signs}",
            "guard.brake_limit": f"at most 0.7, and 0.8 is requested{signs}",
        }

    @pytest.mark.parametrize("name", [name for name in REAL if name != "usb2_tras"])
    def test_a_shipped_profile_is_within_them_and_what_it_has_takes_no_signature(self, name):
        shipped = load_config(profile=name)
        address = f"{shipped.board.kind}:"
        check_limits(address, shipped)
        more = load_config(settings=[f"guard.bucket_limit={shipped.guard.bucket_limit + 1}"], profile=name)
        with pytest.raises(ConfigError, match=r"guard\.bucket_limit: .*: more needs a signed profile"):
            check_limits(address, more)

    def test_a_mocks_profile_may_use_a_real_boards_address(self):
        mock = load_config(profile="sim_usb")
        check_kind("usb:", mock)
        check_limits("usb:", mock)

    def test_a_copy_of_a_mocks_profile_with_a_real_boards_name_is_refused(self):
        copied = load_config(settings=["board.application_names=['ABSIM', 'INTECO']"], profile="sim_usb")
        with pytest.raises(ConfigError, match=r"board\.simulated: the profile was made for the mock"):
            check_kind("usb:", copied)

    def test_a_sign_off_cannot_make_a_real_boards_profile_simulated(self):
        signed = ["board.verified_by=me", "board.verified_on=2026-01-01", "board.verified_logic=0x0103"]
        assert load_config(settings=signed, profile="usb2_generic_0103").board.verified_by == "me"
        with pytest.raises(ConfigError, match=r"board\.simulated: true in a signed configuration of a real board"):
            load_config(settings=[*signed, "board.simulated=true"], profile="usb2_generic_0103")

    def test_a_kind_that_no_family_has_is_refused_with_those_that_there_are(self):
        with pytest.raises(ConfigError, match=r"board\.kind: no board family 'USB2'; known: open, pci, usb, usb2"):
            load_config(settings=["board.kind=USB2"], checks=[kind_check])

    def test_a_session_with_any_limits_is_still_read(self):
        text = load_config(profile="usb2_generic_0103").to_toml().replace("silence_s = 0.05", "silence_s = 2.0")
        assert parse_config(text).guard.silence_s == 2.0


class TestEvidence:
    def test_without_a_signature_outputs_need_everything_confirmed(self):
        confirmed = {key: Evidence(status="confirmed", source="seen") for key in WIRING}
        base = {"logic_version": 0x0103, "application_names": ["ABSSIM"], "pwm_functions": [2, 5], "numbering_pwm": 7}
        base |= {"timer": 0, "constants": {"w9": 0}}
        base |= {"numbering_pins": [7], "watchdog_pin": 8, "watchdog_contact_pin": 9}
        board = BoardConfig(**base, evidence=confirmed)
        assert unconfirmed(board) == []
        for key in WIRING:
            rest = {name: one for name, one in confirmed.items() if name != key}
            assert unconfirmed(BoardConfig(**base, evidence=rest)) == [f"{key} (unknown)"]

    def test_the_refusal_names_what_is_not_confirmed(self):
        settings = ["profile=usb2_generic_0103", 'board.application_names=["ABSSIM"]']
        because = opened(load_config(settings=settings)).read_only_because
        assert "drive_pwm (inferred)" in because
        assert "counts_per_turn (inferred)" in because

    def test_evidence_for_what_does_not_exist_is_a_mistake(self):
        with pytest.raises(ConfigError, match="did you mean drive_pwm"):
            load_config(settings=['board.evidence.drive_pmw={status="confirmed"}'])

    def test_a_status_is_one_of_three(self):
        with pytest.raises(ConfigError, match=r"board\.evidence\.drive_pwm\.status"):
            load_config(settings=['board.evidence.drive_pwm={status="sure"}'])

    def test_it_cannot_be_claimed_on_the_command_line(self):
        with pytest.raises(ConfigError, match=r"board\.evidence\.road_sign: evidence belongs in a file"):
            load_config(settings=["profile=pci_abs_50f", 'board.evidence.road_sign={status="confirmed"}'])

    def test_a_profile_for_reading_never_drives_even_when_signed(self):
        config = load_config(
            settings=[
                "profile=usb2_tras",
                'board.application_names=["ABSSIM"]',
                "board.verified_by=A. Lab",
                "board.verified_on=2026-03-04",
                "board.verified_logic=0x0103",
            ]
        )
        assert "two-rotor" in opened(config).read_only_because


def test_unknown_abs_logic_profile_begins_from_what_known_logics_share():
    board = load_config(profile="usb2_abs_candidate").board
    assert (board.frame_map, board.pwm_pins, board.pwm_functions) == ("abs", [19, 23], [])
    assert (board.constants, board.timer) == ({"pwm_thermal_flags": 3}, 0)
    assert {"frame_map (inferred)", "constants (inferred)", "pwm_pins (inferred)"} <= set(unconfirmed(board))


def test_a_channel_that_the_logic_does_not_have_is_refused_with_its_key():
    config = load_config(settings=["board.road_encoder=9"])
    with pytest.raises(ConfigError, match=r"board\.road_encoder: 9"):
        board_behind(InProcessLink(front_end_of(Device(load_config(), lambda: 0))), config, lambda: 0)
