"""What a browser may ask for becomes arguments of `run`; nothing else does."""

import pytest
from serving import served

from inteco_abs.browser import run_words
from inteco_abs.errors import ConfigError


def words(**asked):
    return run_words(asked, served(), ["sim:"])


def test_a_value_is_in_one_word_with_its_option():
    assert words(
        virtual=True, seed=3, rig="hard:17", note="--set=guard.brake_limit=1", controller="pi", estimator="kalman",
        gains={"Kp": 2, "reference_slip": 0.3}, speed=60,
    ) == [
        "--board=sim:", "--seed=3", "--virtual", "--rig=hard:17", "--note=--set=guard.brake_limit=1",
        "--controller=pi", "--estimator=kalman", "--set=controller.gains.Kp=2.0",
        "--set=controller.reference_slip=0.3", "--set=experiment.start_speed_rad_s=60.0",
    ]  # fmt: skip
    assert words() == ["--board=sim:", "--seed=0", "--controller=reaching-law"]


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"board": "usb2:123"}, "--allow-board"),
        ({"board": ["sim:"]}, "--allow-board"),
        ({"settings": ["guard.brake_limit=1"]}, "not a choice here"),
        ({"out": "/etc/passwd"}, "not a choice here"),
        ({"seed": -1}, "whole number"),
        ({"seed": True}, "whole number"),
        ({"seed": 1 << 63}, "whole number"),
        ({"rig": "../../etc/passwd:1"}, "hard:17"),
        ({"rig": 5}, "hard:17"),
        ({"note": "x" * 501}, "500"),
        ({"note": ["x"]}, "500"),
        ({"controller": "evil.py:Law"}, "not one of those"),
        ({"controller": ["pi"]}, "not one of those"),
        ({"estimator": "evil.py:Law"}, "not one of those"),
        ({"gains": [1]}, "names and numbers"),
        ({"gains": {"Mkk": 1}}, "did you mean Mk?"),
        ({"gains": {"Kp": 1}}, "not a gain of reaching-law"),
        ({"gains": {"Mk": "5"}}, "must be a number"),
        ({"gains": {"Mk": float("nan")}}, "must be a number"),
        ({"gains": {"Mk": True}}, "must be a number"),
        ({"speed": float("inf")}, "must be a number"),
    ],
)
def test_what_is_no_choice_of_a_browser_is_refused(asked, text):
    with pytest.raises(ConfigError, match=text.replace("?", "[?]")):
        words(**asked)


@pytest.mark.parametrize(
    ("remote", "boards"),
    [
        ("127.0.0.1", ["sim:", "usb2:123"]),
        ("::1", ["sim:", "usb2:123"]),
        ("192.168.1.7", ["sim:"]),
        ("fe80::1", ["sim:"]),
        (None, ["sim:"]),
        ("", ["sim:"]),
    ],
)
def test_a_real_board_is_for_a_browser_on_its_computer(remote, boards):
    assert served().boards_for(remote) == boards


@pytest.mark.parametrize(
    ("host", "local"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("lab.example", False)],  # noqa: S104  asked for
)
def test_what_can_be_reached_from_the_network_is_known(host, local):
    assert served(host=host).local is local
