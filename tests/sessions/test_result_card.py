"""Definitions of the result card, on stops that are made up so that the answers are known."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.rig import RigParameters
from inteco_abs.sessions import TICK, TRUTH, result_card
from inteco_abs.sessions.card import RunningCard
from inteco_abs.signals import Phase

REFERENCE = 0.25
PERIOD_NS = 500_000
TRUE_ONLY = ("slip_rms_true", "slip_rms_low_speed_true", "slip_rms_fixed_true")
METRICS = (
    "reaching_time_s",
    "band_entry_s",
    "stop_time_s",
    "stop_distance_m",
    "slip_rms_true",
    "slip_rms_estimated",
    "slip_rms_low_speed_true",
    "slip_rms_fixed_true",
    "lock_fraction",
    "torque_variation_nm_per_s",
    "duty_variation_per_s",
)
EXACT = 1e-12


@pytest.fixture(scope="module")
def config():
    return load_config(settings=[f"controller.reference_slip={REFERENCE}"])


class MadeUp:
    """Ticks and truth of a stop; `start` ticks of spin-up come before it. Times from the start of braking."""

    def __init__(self, slip, speed, phase=Phase.BRAKING, start=7, **columns) -> None:
        slip, speed = np.broadcast_arrays(np.asarray(slip, float), np.asarray(speed, float))
        count = start + len(slip)
        self.ticks, self.truth = np.zeros(count, TICK.dtype), np.zeros(count, TRUTH.dtype)
        self.ticks["tick"] = np.arange(count)
        self.ticks["time_ns"] = self.truth["time_ns"] = 10**12 + np.arange(count) * PERIOD_NS
        self.ticks["phase"][:start] = Phase.SPIN_UP
        self.ticks["phase"][start:] = phase
        for rows in (self.ticks, self.truth):
            rows["slip"][:start], rows["road_speed_rad_s"][:start] = REFERENCE, 300.0  # must not be looked at
            rows["slip"][start:], rows["road_speed_rad_s"][start:] = slip, speed
        for name, values in columns.items():
            self.ticks[name][start:] = values

    def card(self, config, *, real_rig=False):
        return result_card(config, self.ticks, self.truth[:0] if real_rig else self.truth)


def seconds(tick):
    return tick * PERIOD_NS * 1e-9


def stair(*steps):
    """Values from (how many, value)."""
    return np.concatenate([np.full(count, value, float) for count, value in steps])


@pytest.mark.parametrize("real_rig", [False, True])
def test_reaching_is_the_first_crossing_and_band_entry_within_0_01(config, real_rig):
    slip = np.arange(400) / 1024
    card = MadeUp(slip, 100.0).card(config, real_rig=real_rig)
    assert card["reaching_time_s"] == pytest.approx(seconds(256), abs=EXACT)
    assert card["band_entry_s"] == pytest.approx(seconds(246), abs=EXACT)  # 246 / 1024 > 0.24 > 245 / 1024


def test_a_slip_that_jumps_over_the_band_reaches_without_entering(config):
    card = MadeUp(stair((100, 0.0), (100, 0.5)), 100.0).card(config)
    assert card["reaching_time_s"] == pytest.approx(seconds(100), abs=EXACT)
    assert [card[key] for key in ("band_entry_s", "slip_rms_true", "slip_rms_estimated")] == [None] * 3


def test_a_slip_that_stays_below_never_reaches(config):
    card = MadeUp(stair((300, 0.125)), 100.0).card(config)
    assert (card["reaching_time_s"], card["band_entry_s"]) == (None, None)


def test_start_speed_is_that_of_the_first_tick_of_braking(config):
    stop = MadeUp(0.0, np.linspace(180.0, 0.0, 500))
    stop.truth["road_speed_rad_s"][7] = 179.5
    assert stop.card(config)["start_speed_rad_s"] == 179.5
    assert stop.card(config, real_rig=True)["start_speed_rad_s"] == 180.0


ENTRY = 101
SETTLED = ENTRY + 40  # 20 ms
WINDOW = stair((ENTRY, 0.0), (1, REFERENCE), (39, 0.75), (200, REFERENCE + 0.125), (100, REFERENCE - 0.0625), (50, 0.9))
SPEEDS = stair((SETTLED + 200, 60.5), (99, 60.0), (1, 10.0), (50, 9.75))


def rms(*parts):
    """RMS from (how many, error)."""
    return math.sqrt(sum(count * error**2 for count, error in parts) / sum(count for count, _ in parts))


def test_slip_rms_covers_20_ms_after_band_entry_down_to_10_rad_per_s(config):
    assert MadeUp(WINDOW, SPEEDS).card(config)["slip_rms_true"] == pytest.approx(rms((200, 0.125), (100, 0.0625)))


def test_low_speed_is_the_same_window_from_60_to_10_rad_per_s(config):
    assert MadeUp(WINDOW, SPEEDS).card(config)["slip_rms_low_speed_true"] == pytest.approx(0.0625)


def test_60_and_10_rad_per_s_belong_to_low_speed(config):
    slip = stair((ENTRY, 0.0), (1, REFERENCE), (39, 0.75), (50, 0.75), (1, 0.5), (100, REFERENCE), (1, 0.375), (9, 0.9))
    speed = stair((SETTLED, 70.0), (50, 60.25), (1, 60.0), (100, 30.0), (1, 10.0), (9, 9.75))
    card = MadeUp(slip, speed).card(config)
    assert card["slip_rms_low_speed_true"] == pytest.approx(rms((1, 0.25), (100, 0.0), (1, 0.125)))


def test_low_speed_does_not_begin_before_the_window(config):
    speed = stair((SETTLED + 200, 50.0), (100, 40.0), (50, 9.0))
    card = MadeUp(WINDOW, speed).card(config)
    assert card["slip_rms_low_speed_true"] == pytest.approx(rms((200, 0.125), (100, 0.0625)))


def test_window_begins_with_the_tick_20_ms_after_band_entry(config):
    expected = rms((1, 0.25), (100, 0.0))
    found = {}
    for entry in range(600):
        slip = stair((entry, 0.0), (1, REFERENCE), (39, 0.75), (1, 0.5), (100, REFERENCE))
        found[entry] = MadeUp(slip, 100.0).card(config)["slip_rms_true"]
    assert {entry: value for entry, value in found.items() if value != pytest.approx(expected)} == {}


@pytest.mark.parametrize("entry", [0, 50, 700])
def test_fixed_begins_a_quarter_of_a_second_after_braking_at_any_slip(config, entry):
    slip = stair((500, 0.75), (400, 0.5), (400, 0.9))
    slip[entry] = REFERENCE
    speed = stair((900, 100.0), (400, 5.0))
    inside = 400 - (entry >= 500)
    assert MadeUp(slip, speed).card(config)["slip_rms_fixed_true"] == pytest.approx(
        rms((inside, 0.25), (400 - inside, 0))
    )


def test_fixed_is_there_even_if_the_band_was_never_entered(config):
    card = MadeUp(stair((1000, 0.75)), 100.0).card(config)
    assert card["slip_rms_true"] is None
    assert card["slip_rms_fixed_true"] == pytest.approx(0.5)


def test_estimated_and_true_slip_are_judged_apart_in_the_same_window(config):
    stop = MadeUp(WINDOW, SPEEDS)
    stop.ticks["slip"][7:] = stair((SETTLED, 0.0), (300, REFERENCE + 0.5), (50, 0.0))
    card = stop.card(config)
    assert card["slip_rms_estimated"] == pytest.approx(0.5)
    assert card["slip_rms_true"] == pytest.approx(rms((200, 0.125), (100, 0.0625)))


def test_without_a_truth_the_estimate_decides_and_true_metrics_are_none(config):
    card = MadeUp(WINDOW, SPEEDS).card(config, real_rig=True)
    assert card["slip_rms_estimated"] == pytest.approx(rms((200, 0.125), (100, 0.0625)))
    assert card["band_entry_s"] == pytest.approx(seconds(ENTRY), abs=EXACT)
    assert [card[key] for key in TRUE_ONLY] == [None] * 3


def test_window_ends_below_10_rad_per_s_and_does_not_reopen(config):
    slip = stair((100, 0.0), (1, REFERENCE), (39, 0.75), (200, REFERENCE + 0.125), (50, 0.9), (50, 0.9))
    speed = stair((340, 50.0), (50, 9.0), (50, 11.0))  # an estimate that is coarse at low speed comes back
    card = MadeUp(slip, speed).card(config, real_rig=True)
    assert card["slip_rms_estimated"] == pytest.approx(0.125)


def test_the_newest_truth_at_or_before_a_tick_is_that_of_the_tick(config):
    stop = MadeUp(WINDOW, SPEEDS)
    stop.truth["slip"][:7] = 0.0
    stop.truth["time_ns"] -= PERIOD_NS // 3
    assert stop.card(config)["band_entry_s"] == pytest.approx(seconds(ENTRY), abs=EXACT)
    stop.truth["time_ns"] += PERIOD_NS // 3 + 1
    assert stop.card(config)["band_entry_s"] == pytest.approx(seconds(ENTRY + 1), abs=EXACT)


def test_lock_fraction_counts_slip_above_0_9_over_10_rad_per_s(config):
    slip = stair((300, 0.2), (60, 0.9), (40, 0.91), (100, 1.0))
    speed = stair((400, 50.0), (100, 9.0))
    assert MadeUp(slip, speed).card(config)["lock_fraction"] == pytest.approx(40 / 400)


def test_a_wheel_that_does_not_lock(config):
    assert MadeUp(WINDOW, 50.0).card(config)["lock_fraction"] == 0.0


def test_stop_time_and_distance_end_when_the_road_is_below_half_a_rad_per_s(config):
    speed = stair((1000, 100.0), (200, 0.5), (100, 0.49), (100, 3.0))
    phase = np.repeat([Phase.BRAKING, Phase.STOPPED], [1250, 150])
    counts = 5000 + np.arange(1400) * 3
    card = MadeUp(0.0, speed, phase, road_count=counts).card(config)
    assert card["stop_time_s"] == pytest.approx(seconds(1200), abs=EXACT)
    r2 = RigParameters.named("mask").r2
    assert card["stop_distance_m"] == pytest.approx(3600 / 2048 * 2.0 * math.pi * r2)


def test_a_road_that_comes_to_rest_only_while_the_brake_is_held_has_stopped(config):
    phase = np.repeat([Phase.BRAKING, Phase.STOPPED], [500, 500])
    card = MadeUp(0.0, stair((500, 50.0), (100, 0.6), (400, 0.0)), phase).card(config)
    assert card["stop_time_s"] == pytest.approx(seconds(600), abs=EXACT)


def test_distance_counts_in_the_encoders_own_counts(config):
    fine = replace(config, encoders=replace(config.encoders, counts_per_turn=4096))
    stop = MadeUp(0.0, stair((10, 20.0), (10, 0.0)), road_count=np.arange(20) * 100)
    assert stop.card(config)["stop_distance_m"] == pytest.approx(2.0 * stop.card(fine)["stop_distance_m"])


@pytest.mark.parametrize("after", [Phase.FAULT, Phase.DONE])
def test_a_road_that_rolls_out_with_the_brake_off_was_not_stopped(config, after):
    speed = stair((500, 50.0), (500, 0.0))
    phase = np.repeat([Phase.BRAKING, after], [500, 500])
    card = MadeUp(0.0, speed, phase).card(config)
    assert (card["stop_time_s"], card["stop_distance_m"]) == (None, None)


def test_variation_is_per_second_until_the_road_is_below_10_rad_per_s(config):
    duties = np.where(np.arange(400) % 2, 0.75, 0.5)
    duties[300:] = np.where(np.arange(100) % 2, 1.0, 0.0)
    speed = stair((300, 50.0), (100, 9.0))
    card = MadeUp(0.0, speed, brake=duties).card(config)
    b1 = RigParameters.named("mask").b1
    assert card["duty_variation_per_s"] == pytest.approx(299 * 0.25 / seconds(300))
    assert card["torque_variation_nm_per_s"] == pytest.approx(299 * 0.25 * b1 / seconds(300))


def test_a_constant_brake_has_no_variation(config):
    card = MadeUp(0.0, stair((300, 50.0), (100, 9.0)), brake=0.5).card(config)
    assert (card["duty_variation_per_s"], card["torque_variation_nm_per_s"]) == (0.0, 0.0)


def test_torque_does_not_vary_in_the_brakes_dead_zone(config):
    dead = RigParameters.named("mask").u0 * 0.9
    duties = np.where(np.arange(400) % 2, dead, 0.0)
    card = MadeUp(0.0, stair((300, 50.0), (100, 9.0)), brake=duties).card(config)
    assert card["torque_variation_nm_per_s"] == 0.0
    assert card["duty_variation_per_s"] == pytest.approx(299 * dead / seconds(300))


def test_lateness_percentiles(config):
    stop = MadeUp(0.0, stair((1000, 50.0)), start=1)
    stop.ticks["late_us"] = np.random.default_rng(1).permutation(1001)
    expected = {"p50": 500.0, "p99": 990.0, "p999": 999.0, "max": 1000.0}
    assert stop.card(config)["lateness_us"] == pytest.approx(expected)


@pytest.mark.parametrize("number", [1, 2, 1001, 150_000])
def test_lateness_has_numpys_bits_in_any_number_of_pieces(config, number):
    late_us = np.random.default_rng(number).exponential(20.0, number).round(3).astype(np.float32)
    ticks, card = np.zeros(number, TICK.dtype), RunningCard(config)
    ticks["late_us"] = late_us
    for at in range(0, number, 700):
        card.add(ticks[at : at + 700], np.zeros(0, TRUTH.dtype))
    expected = np.percentile(late_us.astype(float), (50.0, 99.0, 99.9, 100.0)).tolist()
    assert list(card.card()["lateness_us"].values()) == expected


def test_overruns_are_the_periods_that_were_skipped_in_any_phase(config):
    stop = MadeUp(0.0, stair((100, 50.0)))
    stop.ticks["skipped"][[0, 3, 50]] = (1, 2, 4)
    card = stop.card(config)
    assert (card["overruns"], card["ticks"]) == (7, 107)


@pytest.mark.parametrize("phases", [[Phase.IDLE], [Phase.SPIN_UP], [Phase.SPIN_UP, Phase.FAULT]])
def test_a_run_that_did_not_brake_has_no_metrics(config, phases):
    card = MadeUp(0.9, stair((500 * len(phases), 0.0)), np.repeat(phases, 500)).card(config)
    assert [card[key] for key in (*METRICS, "start_speed_rad_s")] == [None] * (len(METRICS) + 1)
    assert card["ticks"] == 507 + 500 * (len(phases) - 1)
    assert card["lateness_us"]["max"] == 0.0


def test_no_ticks_at_all(config):
    card = result_card(config, np.zeros(0, TICK.dtype), np.zeros(0, TRUTH.dtype))
    assert (card["ticks"], card["overruns"]) == (0, 0)
    assert [card[key] for key in METRICS] == [None] * len(METRICS)
    assert card["lateness_us"] == dict.fromkeys(("p50", "p99", "p999", "max"))


def test_a_single_tick_of_braking(config):
    card = MadeUp([0.0], [100.0]).card(config)
    assert card["start_speed_rad_s"] == 100.0
    assert card["lock_fraction"] == 0.0
    assert [card[key] for key in METRICS if key != "lock_fraction"] == [None] * (len(METRICS) - 1)


def test_card_says_what_was_run(config):
    other = load_config(settings=["controller.name=relay", "estimator.name=euler", "controller.reference_slip=0.3"])
    names = ("controller", "estimator", "reference_slip")
    stop = MadeUp(0.0, stair((10, 50.0)))
    assert [stop.card(config)[name] for name in names] == ["reaching-law", "moving-window", REFERENCE]
    assert [stop.card(other)[name] for name in names] == ["relay", "euler", 0.3]


@pytest.mark.parametrize("real_rig", [False, True])
def test_every_card_has_the_same_keys_and_is_json(config, real_rig):
    cards = [
        MadeUp(WINDOW, SPEEDS).card(config, real_rig=real_rig),
        MadeUp([0.0], [100.0], Phase.IDLE).card(config, real_rig=real_rig),
        result_card(config, np.zeros(0, TICK.dtype), np.zeros(0, TRUTH.dtype)),
    ]
    assert {frozenset(card) for card in cards} == {frozenset(cards[0])}
    assert set(METRICS) < cards[0].keys()
    assert [json.loads(json.dumps(card, allow_nan=False)) for card in cards] == cards


def test_card_of_a_whole_run_has_every_key_of_the_acceptance_interface(quick):
    expected = {*METRICS, "session", "outcome", "controller", "estimator", "board", "ticks", "overruns", "lost_ticks"}
    expected |= {"start_speed_rad_s", "reference_slip", "lateness_us", "payload_sha256"}
    assert expected <= quick.stop.card.keys()
    assert quick.stop.card["session"] == str(quick.path)
