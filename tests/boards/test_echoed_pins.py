"""Outputs that change with each frame: a number in spare latches, and the pulse of the watchdog."""

from contextlib import suppress
from itertools import pairwise

import pytest
from benches import LateByMany, Usb0111Bench

from inteco_abs.errors import BoardError, ConfigError, UnsafeError
from inteco_abs.realtime.watchdog import prove_watchdog
from inteco_abs.signals import BoardFlags

WATCHED = (
    "board.watchdog_pin=17",
    "board.watchdog_contact_pin=9",
    "simulation.watchdog_pin=17",
    "simulation.watchdog_contact_pin=9",
)


@pytest.fixture(params=["rtdac-usb2", "rtdac-usb 0x0111"])
def new_pins_bench(request, new_usb2_bench):

    return new_usb2_bench if request.param == "rtdac-usb2" else Usb0111Bench


def levels(bench, pin=17):
    return [sent["pin_output"] >> pin & 1 for sent in bench.settings_sent]


def changes(bench, pin=17):
    return sum(a != b for a, b in pairwise(levels(bench, pin)))


@pytest.mark.parametrize(
    ("pins", "exchanges", "seen"),
    [
        ([7], 1, True),
        ([7], 2, False),
        ([7], 3, True),
        ([7, 18], 1, True),
        ([7, 18], 2, True),
        ([7, 18], 3, True),
        ([7, 18], 4, False),
        ([0, 14, 15, 25], 8, True),
        ([0, 14, 15, 25], 16, False),
    ],
)
def test_n_spare_pins_show_every_lateness_but_multiples_of_two_to_the_n(new_usb2_bench, pins, exchanges, seen):
    bench = new_usb2_bench("board.numbering_pwm=-1", f"board.numbering_pins={pins}")
    link = bench.board._link = LateByMany(bench.link)
    with suppress(UnsafeError), bench.board:
        for _ in range(40):
            assert bench.exchange(1.0).board_flags is BoardFlags.NONE
        link.begin(exchanges)
        flags = {bench.exchange(1.0).board_flags for _ in range(8)}
    assert flags == {BoardFlags.STALE if seen else BoardFlags.NONE}


def test_the_number_stands_in_the_latch_and_nothing_else_of_the_pins_moves(new_pins_bench):
    bench = new_pins_bench("board.numbering_pins=[7, 18]", earlier={"pin_output": 1 << 3 | 1 << 18})
    with bench.board:
        for _ in range(6):
            assert bench.exchange(0.5).board_flags is BoardFlags.NONE
    numbers = [(sent["pin_output"] >> 7 & 1) + 2 * (sent["pin_output"] >> 18 & 1) for sent in bench.settings_sent]
    assert numbers == [(1 + i) % 4 for i in range(8)]
    assert {sent["pin_output"] & ~(1 << 7 | 1 << 18) for sent in bench.settings_sent} == {1 << 3}


def test_the_watchdog_is_fed_in_each_armed_exchange_after_a_good_one(new_pins_bench):
    bench = new_pins_bench(*WATCHED)
    with bench.board as board:
        bench.exchange()
        assert changes(bench) == 0
        board.armed = True
        for _ in range(5):
            bench.exchange(0.5)
        assert changes(bench) == 5
        bench.fail_next("no answer")
        bench.exchange(0.5)  # was fed: the one before was good
        bench.exchange(0.5)  # after a bad one: not fed
        assert changes(bench) == 6
        bench.exchange(0.5)
        assert changes(bench) == 7
        board.armed = False
        bench.exchange(0.5)
        board.make_safe()
        assert changes(bench) == 7
    assert changes(bench) == 7


def test_the_watchdogs_pin_is_an_output_and_its_contact_an_input(new_usb2_bench):
    bench = new_usb2_bench(*WATCHED, earlier={"pin_direction": 1 << 17, "pin_mode": 1 << 17 | 1 << 9})
    with bench.board:
        sent = bench.settings_sent[0]
    assert (sent["pin_direction"] >> 17 & 1, sent["pin_direction"] >> 9 & 1) == (0, 1)
    assert not sent["pin_mode"] & (1 << 17 | 1 << 9)


def test_motors_lose_power_50_ms_after_the_last_pulse_for_any_host(new_pins_bench):
    bench = new_pins_bench(*WATCHED)
    seen = []
    bench.device._observe = seen.append
    with bench.board as board:
        assert board.watchdog_closed is False
        bench.exchange(1.0)
        assert bench.device.duties == (0.0, 0.0)
        board.armed = True
        bench.exchange(1.0)
        assert board.watchdog_closed is True
        assert bench.device.duties == (1.0, 0.0)
        fed_ns = bench.clock.time_ns
        bench.clock.advance(40_000_000)
        bench.device.catch_up()
        assert bench.device.duties == (1.0, 0.0)
        bench.clock.advance(60_000_000)  # the host is gone
        bench.device.catch_up()
        assert bench.device.duties == (0.0, 0.0)
        assert (seen[-1].time_ns - fed_ns, seen[-1].drive) == (50_000_000, 0.0)
        bench.exchange(0.0)
        assert board.watchdog_closed is True  # it was armed all the time: the lab's ON button is what stays off


@pytest.mark.parametrize(("pin", "contact"), [(0, 9), (17, 0)])
def test_pin_0_can_feed_a_watchdog_or_be_its_contact(new_pins_bench, pin, contact):
    settings = [s.replace("_pin=17", f"_pin={pin}").replace("contact_pin=9", f"contact_pin={contact}") for s in WATCHED]
    bench = new_pins_bench("board.pwm_pins=[]", "board.pwm_functions=[]", *settings)
    with bench.board as board:
        assert board.watchdog_closed is False
        board.armed = True
        bench.exchange(0.5)
        bench.exchange(0.5)
        assert board.watchdog_closed is True
        assert changes(bench, pin) == 2


def test_a_constant_pin_is_beside_the_number_in_the_latch(new_pins_bench):
    bench = new_pins_bench("board.numbering_pins=[7]", "board.constants={pin3=1}")
    with bench.board:
        assert bench.exchange(0.5).board_flags is BoardFlags.NONE
    assert [sent["pin_output"] for sent in bench.settings_sent] == [1 << 3 | (1 + i) % 2 << 7 for i in range(3)]


def test_a_rescue_feeds_the_watchdog_once_at_most(new_usb2_bench):
    bench = new_usb2_bench(*WATCHED)
    board = bench.board.__enter__()
    image, board.armed = board.safe_image, True
    for _ in range(4):
        bench.exchange(1.0)
    bench.plug_in()
    bench.board.rescue(image)
    assert changes(bench) == 0
    assert bench.device.duties == (0.0, 0.0)


def test_a_contact_that_is_closed_before_anything_feeds_it_is_refused(new_usb2_bench):
    bench = new_usb2_bench(*WATCHED)
    bench.link.change_answer = lambda answer: answer[:33] + b"\2" + answer[34:]  # pin 9 is always high
    with bench.board as board, pytest.raises(BoardError, match="stays closed although nothing feeds it"):
        prove_watchdog(board, bench.config.period_ns, lambda seconds: bench.clock.advance(round(seconds * 1e9)))
    assert changes(bench) == 0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("board.watchdog_pin=8",), "name both pins or neither"),
        (("board.watchdog_contact_pin=8",), "name both pins or neither"),
        (("board.watchdog_pin=8", "board.watchdog_contact_pin=8"), "8: already in board.watchdog_pin"),
        (("board.watchdog_pin=0", "board.watchdog_contact_pin=0"), "0: already in board.watchdog_pin"),
        (("board.numbering_pins=[2]",), "2: already in board.pwm_pins"),
        (("board.numbering_pins=[7, 7]",), "7: already in board.numbering_pins"),
    ],
)
def test_a_pin_has_one_use_and_a_watchdog_a_contact(new_usb2_bench, settings, words):
    with pytest.raises(ConfigError, match=words):
        new_usb2_bench(*settings)


@pytest.mark.parametrize(
    ("settings", "key"), [([], "pwm_pins"), (["board.pwm_functions=[0]"], "pwm_functions")], ids=["pins", "functions"]
)
def test_a_logic_without_a_pin_mode_has_no_pwm_functions(new_usb2_bench, settings, key):
    with pytest.raises(ConfigError, match=rf"board\.{key}: .* has no pin mode: set board\.pwm_functions to \[\]"):
        new_usb2_bench("board.frame_map=tras", "board.constants={}", *settings)


@pytest.mark.parametrize("setting", ["board.timer=0", "board.numbering_pins=[7]", "board.watchdog_pin=8"])
def test_a_pci_board_has_no_such_settings(new_pci_bench, setting):
    with pytest.raises(ConfigError, match="has no frames and no known digital pins"):
        new_pci_bench(setting)
