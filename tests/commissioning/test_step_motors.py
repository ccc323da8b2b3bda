"""Steps 5 and 6 on rigs that are not as they should be."""

import pytest

from inteco_abs.errors import CommissioningError, ReadOnlyError


@pytest.fixture
def at(lab, scripts):
    """A lab before a step, with the answers for it, whose switches follow the operator or stay as they are."""

    def prepare(step, *settings, switch=None):
        lab.done_until(step, settings)
        procedure = lab.session(*scripts[step])
        if switch is not None:
            lab.rig.switch = switch(lab.rig.device)
        return procedure

    return prepare


def test_the_dead_zone_is_found(lab, at):
    at("motors").go(only="motors")
    found = lab.draft.results["motors"]
    assert found["brake_from"] == pytest.approx(0.415, abs=0.03)
    assert 0.05 < found["moving_duty"] < 0.15
    assert found["coast_rad_s2"] == pytest.approx(3.1, abs=0.5)
    evidence = lab.draft.config.board.evidence
    assert evidence["drive_pwm"].status == evidence["brake_pwm"].status == "confirmed"


def test_a_power_interface_that_is_on_is_noticed_at_the_first_movement(lab, at):
    procedure = at("echo", switch=lambda device: lambda _on: device.turn("road", 10, 5.0))
    with pytest.raises(CommissioningError, match="although the power interface should be off"):
        procedure.go(only="echo")
    assert lab.rig.device.duties == (0.0, 0.0)


def test_a_board_that_does_not_take_the_mode_fails_the_echo_test(lab, at):
    procedure = at("echo")
    lab.rig.change_answer = lambda answer: answer[:42] + bytes([answer[42] & 0xFE]) + answer[43:]
    with pytest.raises(Exception, match="pwm0_mode = 0, not 1"):
        procedure.go(only="echo")
    assert lab.outcomes()["echo"] == "failed"


@pytest.mark.long
def test_an_emergency_switch_that_does_not_cut_is_noticed(lab, at):
    procedure = at("motors", switch=lambda device: lambda _on: device.power(on=True))
    with pytest.raises(CommissioningError, match="although the emergency switch is pressed"):
        procedure.go(only="motors")
    assert lab.rig.device.duties == (0.0, 0.0)


def test_a_drive_without_power_is_noticed(at):
    procedure = at("motors", switch=lambda device: lambda _on: device.power(on=False))
    with pytest.raises(CommissioningError, match=r"no wheel moved at up to 20% drive.*--set board.drive_pwm"):
        procedure.go(only="motors")


def test_swapped_pwm_channels_show_as_a_drive_that_does_nothing(lab, at):
    procedure = at("motors", "simulation.drive_pwm=1", "simulation.brake_pwm=0")
    with pytest.raises(CommissioningError, match="really on PWM 0"):
        procedure.go(only="motors")
    assert lab.rig.device.duties == (0.0, 0.0)


def test_a_brake_that_is_not_there_is_noticed_at_the_limit(lab, at):
    procedure = at("motors", "simulation.brake_pwm=3")
    with pytest.raises(CommissioningError, match=r"the brake did nothing up to 0\.70"):
        procedure.go(only="motors")
    assert lab.rig.device.duties == (0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "name"), [("road_sign", "lower"), pytest.param("wheel_sign", "upper", marks=pytest.mark.long)]
)
def test_a_wheel_that_was_turned_the_wrong_way_round_is_found_out_by_the_drive(lab, scripts, key, name):
    lab.done_until("wheels", [f"simulation.{key}=-1"])
    lab.session(*scripts["wheels"])
    which = "wheel" if key == "wheel_sign" else "road"
    # the operator turns this wheel backwards, so that it counts up, and all seems well
    lab.rig.hand = lambda asked: lab.rig.device.turn(asked, -10 if asked == which else 10, 5.0)
    lab.procedure.go(only="wheels")
    procedure = lab.session(*scripts["echo"], *scripts["motors"])
    procedure.go(only="echo")
    with pytest.raises(CommissioningError, match=f"the {name} wheel counts backwards when driven: board.{key}"):
        procedure.go(only="motors")
    assert lab.rig.device.duties == (0.0, 0.0)


@pytest.mark.parametrize("when", [False, True], ids=["before the switch is tried", "after it"])
def test_wheels_that_do_not_rest_are_not_driven(lab, at, when):
    def switch(device):
        return lambda on: device.turn("road", 10, 60.0) if on is when else device.power(on=on)

    procedure = at("motors", switch=switch)
    with pytest.raises(CommissioningError, match="wait until both are at rest"):
        procedure.go(only="motors")
    assert lab.rig.largest == (0.0, 0.0)


def test_a_board_that_has_changed_its_name_is_not_driven(lab, at):
    procedure = at("motors")
    lab.rig.change_answer = lambda answer: answer[:2] + b"X" + answer[3:]
    with pytest.raises(ReadOnlyError, match="the profile knows 'ABSSIM'"):
        procedure.go(only="motors")
    assert lab.rig.frames_sent == []


class TestVelocityRegister:
    """The board on the PCI bus counts lines of the encoder's disc in a time of its own."""

    @pytest.fixture
    def on_pci(self, lab, scripts):
        """All steps up to the motors on that board; `turns`: how many the operator reports."""

        def procedure(*answers, turns=(), settings=()):
            wheels = [answer for wheel in ("", "") for answer in (wheel, *turns)]
            before = [*scripts["list"], *scripts["header"], *scripts["reads"], "", *wheels, *scripts["echo"]]
            script = [*before, *scripts["motors"], *answers]
            session = lab.session(*script, profile="pci_abs_50f", settings=settings)
            for step in list(scripts)[:6]:
                session.go(only=step)

        return procedure

    @pytest.mark.long
    @pytest.mark.parametrize(("counts", "turns"), [(4096, ()), (2048, ("10",))])
    def test_it_agrees_with_turns_that_were_counted_well(self, lab, on_pci, counts, turns):
        on_pci(turns=turns, settings=[f"simulation.counts_per_turn={counts}"])
        assert lab.draft.config.encoders.counts_per_turn == counts
        assert lab.draft.results["motors"]["counts_per_turn_by_velocity"] == pytest.approx(counts, rel=0.1)
        assert not lab.operator.heard("velocity register")

    @pytest.mark.long
    def test_it_contradicts_turns_that_were_miscounted(self, lab, on_pci):
        with pytest.raises(CommissioningError, match="counts per turn are not certain: --redo wheels"):
            on_pci("no", turns=("5",), settings=["simulation.counts_per_turn=2048"])
        assert lab.draft.config.encoders.counts_per_turn == 4096
        assert lab.operator.heard("velocity register makes 20")
        assert lab.outcomes()["motors"] == "failed"
        assert lab.rig.device.duties == (0.0, 0.0)

    @pytest.mark.long
    def test_an_operator_certain_of_the_turns_continues(self, lab, on_pci):
        on_pci("yes", turns=("5",), settings=["simulation.counts_per_turn=2048"])
        assert lab.outcomes()["motors"] == "done"
