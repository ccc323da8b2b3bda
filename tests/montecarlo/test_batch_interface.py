import math
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from inteco_abs.montecarlo import BatchPlant
from inteco_abs.rig import POPULATIONS, RigVariation, draw


@pytest.fixture
def three():
    return BatchPlant([draw("hard", seed) for seed in range(3)])


def test_a_batch_starts_rolling_at_180_rad_s_with_the_brakes_released(three):
    assert len(three) == 3
    assert three.road_speed.tolist() == [180.0] * 3
    assert three.slip == pytest.approx([0.0] * 3, abs=1e-12)
    assert three.brake_torque.tolist() == three.wheel_angle.tolist() == three.road_angle.tolist() == [0.0] * 3
    assert three.time_s == 0.0


def test_starts_and_duties_may_differ_from_rig_to_rig():
    batch = BatchPlant([RigVariation()] * 3, np.array([100.0, 150.0, 100.0]), np.array([100.0, 140.0, 0.0]))
    assert batch.wheel_speed.tolist() == [100.0, 140.0, 0.0]
    batch.advance(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.01)
    assert batch.brake_torque.tolist()[:2] == [0.0, 0.0]
    assert batch.brake_torque[2] > 0.0
    assert batch.time_s == 0.01


@pytest.mark.parametrize("population", POPULATIONS)
def test_advance_by_nothing_changes_nothing(population):
    batch = BatchPlant([draw(population, 1)])
    batch.advance(0.0, 1.0, 0.0)
    assert (batch.road_speed[0], batch.road_angle[0], batch.brake_torque[0], batch.time_s) == (180.0, 0.0, 0.0, 0.0)
    batch.advance(0.0, 1.0, 0.1)
    assert 100.0 < batch.road_speed[0] < 180.0


def test_state_arrays_move_on_with_the_rigs_and_cannot_be_written(three):
    speeds = three.road_speed
    three.advance(0.0, 1.0, 0.1)
    assert speeds is three.road_speed
    assert max(speeds) < 180.0
    with pytest.raises(ValueError, match="read-only"):
        speeds[0] = 1.0


def test_a_tick_of_delay_is_a_call_of_advance():
    batch = BatchPlant([RigVariation(command_delay_ticks=ticks) for ticks in (0, 1, 2)])
    torques = []
    for _ in range(3):
        batch.advance(0.0, 1.0, 0.0005)
        torques.append([torque > 0.0 for torque in batch.brake_torque])
    assert torques == [[True, False, False], [True, True, False], [True, True, True]]


def test_counts_are_whole_and_grow_with_the_angle(three):
    before = three.read_encoders()
    three.advance(0.0, 0.0, 0.1)
    for counts, start, angle in zip(three.read_encoders(), before, (three.wheel_angle, three.road_angle), strict=True):
        assert counts.dtype == np.int64
        assert counts - start == pytest.approx(angle * 2048 / (2.0 * math.pi), abs=4.0)


@pytest.mark.parametrize("bad", [-0.001, 1.001, math.nan, math.inf])
@pytest.mark.parametrize("which", ["drive", "brake"])
def test_a_duty_outside_0_to_1_is_refused_with_its_rig_and_nothing_moves(three, which, bad):
    duties = {"drive": 0.0, "brake": 0.0, which: np.array([0.0, 0.5, bad])}
    with pytest.raises(ValueError, match=rf"{which} of rig 2 is .*{bad}.*0\.\.1"):
        three.advance(**duties, duration_s=0.01)
    assert three.time_s == 0.0
    assert three.road_angle.tolist() == [0.0] * 3
    three.advance(0.0, 0.0, 0.01)
    assert three.brake_torque.tolist() == [0.0] * 3


@pytest.mark.parametrize("bad_s", [-1e-9, math.nan, math.inf])
def test_a_duration_that_is_negative_or_not_finite_is_refused(three, bad_s):
    with pytest.raises(ValueError, match=rf"duration_s = {bad_s!r}"):
        three.advance(0.0, 0.0, bad_s)


@pytest.mark.parametrize("speeds", [(math.nan, 1.0), (1.0, math.inf)])
def test_speeds_that_are_not_finite_are_refused(speeds):
    with pytest.raises(ValueError, match="must be finite"):
        BatchPlant([RigVariation()], *speeds)


@pytest.mark.parametrize("bad_s", [0.0, -0.0005, math.nan, math.inf])
def test_a_step_that_is_not_positive_and_finite_is_refused(bad_s):
    with pytest.raises(ValueError, match=rf"max_step_s = {bad_s!r}"):
        BatchPlant([RigVariation()], max_step_s=bad_s)


def test_a_batch_of_no_rigs_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        BatchPlant([])


def test_shards_may_run_in_threads():
    def stop_distances(seeds):
        batch = BatchPlant([draw("rough", seed) for seed in seeds])
        for tick in range(4000):
            batch.advance(0.0, 0.6 if tick % 3 else 0.7, 0.0005)
        return batch.road_angle.tolist()

    with ThreadPoolExecutor(2) as threads:
        shards = list(threads.map(stop_distances, [range(20), range(20, 40)]))
    assert shards[0] + shards[1] == stop_distances(range(40))


def test_without_numba_the_error_names_the_extra():
    code = "import sys; sys.modules['numba'] = None; import inteco_abs.montecarlo"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "AbsError: many rigs at once need numba: pip install 'inteco-abs[lab]'" in done.stderr


def test_the_physics_alone_needs_neither_numba_nor_numpy():
    code = "import sys; sys.modules['numba'] = sys.modules['numpy'] = None; import inteco_abs.rig"
    subprocess.run([sys.executable, "-c", code], check=True)
