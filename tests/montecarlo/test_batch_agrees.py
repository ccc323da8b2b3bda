"""The compiled rigs equal the scalar plants in every situation."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from one_by_one import REGIMES, Scalars, assert_same, compare, compare_regime, rigs_of_all_kinds

from inteco_abs.montecarlo import BatchPlant
from inteco_abs.rig import POPULATIONS, RigVariation, draw

WIDEST = ("late", "wild")
OTHERS = sorted(set(POPULATIONS) - set(WIDEST))
"""Rigs that have nothing which those have not."""


@pytest.mark.untraced
@pytest.mark.parametrize("every", [1, 9])
@pytest.mark.parametrize("population", [*WIDEST, *(pytest.param(one, marks=pytest.mark.long) for one in OTHERS)])
def test_whole_stops_of_random_rigs_agree_down_to_standstill(population, every):
    batch = compare([draw(population, seed) for seed in range(100, 103)], ticks=4400, every=every, full_from=2200)
    assert not batch.road_speed.any()
    assert not batch.wheel_speed.any()


@pytest.mark.untraced
def test_rigs_of_all_kinds_agree_in_one_batch():
    compare(rigs_of_all_kinds(), ticks=1500, every=5, full_from=1200)


@pytest.mark.untraced
@pytest.mark.parametrize("tick_s", [0.0005, pytest.param(0.0137, marks=pytest.mark.long)])
@pytest.mark.parametrize("regime", REGIMES)
def test_every_regime_agrees_also_with_the_drive_on(regime, tick_s):
    compare_regime(*regime, tick_s, ticks=100)


def test_a_second_stop_has_its_own_grip_step():
    rigs = [RigVariation(grip_step=share, grip_step_after_s=0.03) for share in (-0.5, 0.5)]
    batch = BatchPlant(rigs)
    scalars = Scalars(batch, rigs)
    for tick in range(300):
        driven = 100 <= tick < 150
        for each in (batch, scalars):
            each.advance(float(driven), 0.0 if driven else 0.7, 0.0005)
        assert_same(batch, scalars)


def test_another_largest_step_is_that_of_the_scalar_plant():
    rigs = [RigVariation(), draw("rough", 2)]
    batch = BatchPlant(rigs, max_step_s=0.0002)
    scalars = Scalars(batch, rigs, max_step_s=0.0002)
    for each in (batch, scalars):
        each.advance(0.0, 0.6, 0.4)
        each.advance(0.0, 0.7, 0.4)
    assert_same(batch, scalars)


@pytest.mark.untraced
def test_more_commands_on_their_way_than_at_first_have_room():
    rigs = [RigVariation(brake_dead_time_s=0.2), RigVariation()]
    batch = BatchPlant(rigs)
    scalars = Scalars(batch, rigs)
    for tick in range(900):
        for each in (batch, scalars):
            each.advance(0.0, 0.5 + 0.0004 * tick, 0.0005)
        assert_same(batch, scalars)


@pytest.mark.long
@pytest.mark.parametrize("part", [5, 1])
def test_the_kernel_agrees_before_it_is_compiled_as_well(part):
    script = Path(__file__).with_name("one_by_one.py")
    # plain numpy warns of the 64-bit products that wrap, as they are meant to
    command = [sys.executable, "-W", "ignore:overflow", str(script), str(part)]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == "the same\n"


def test_rigs_do_not_touch_each_other():
    rigs = [draw("rough", seed) for seed in range(5)]
    together, alone = BatchPlant(rigs), BatchPlant(rigs[3:4])
    for tick in range(500):
        together.advance(0.0, np.linspace(0.5, 0.7, 5), 0.0005)
        alone.advance(0.0, np.linspace(0.5, 0.7, 5)[3], 0.0005)
        if tick % 100 == 0:
            assert [counts[3] for counts in together.read_encoders()] == [c[0] for c in alone.read_encoders()]
    assert together.wheel_speed[3] == alone.wheel_speed[0]
