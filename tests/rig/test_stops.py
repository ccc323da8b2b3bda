import math
from dataclasses import replace

import pytest

from inteco_abs.rig import Plant, accelerations, brake_duty

pytestmark = pytest.mark.untraced

ROLLING = 0.099 / 0.0995
VENDOR_LAG = 1 / 0.048
VENDOR_U0 = 0.40748031496063


def full_brake_slips(parameters, **changed):
    """Slip every 10 ms of a full brake step from (180, 180) rad/s, past lock."""
    plant, slips = Plant(replace(parameters, **changed), 180.0, 180.0), []
    for _ in range(60):
        slips.append(plant.slip)
        plant.advance(0.0, 1.0, 0.01)
    return slips


@pytest.mark.long
def test_coast_down_takes_as_long_as_the_friction_of_both_wheels_predicts(parameters):
    k = parameters
    plant = Plant(k, 180.0 * ROLLING, 180.0)
    while plant.road_speed > 0.0:
        assert plant.time_s < 60.0
        plant.advance(0.0, 0.0, 0.02)
    ratio = k.r2 / k.r1
    inertia = k.J2 + k.J1 * ratio**2
    static_rad_s2 = (k.M20 + k.M10 * ratio) / inertia
    viscous_per_s = (k.d2 + k.d1 * ratio**2) / inertia
    assert plant.time_s == pytest.approx(math.log1p(viscous_per_s * 180.0 / static_rad_s2) / viscous_per_s, abs=0.05)
    assert plant.time_s == pytest.approx(48.0, abs=0.5)


def test_spin_up_reaches_180_rad_s_in_about_6_s_rolling(parameters):
    plant = Plant(parameters, 0.0, 0.0)
    while plant.road_speed < 180.0:
        plant.advance(1.0, 0.0, 0.005)
        assert plant.time_s < 10.0
    assert plant.time_s == pytest.approx(6.1, abs=0.4)
    assert plant.slip < 0.01


def test_full_brake_locks_the_wheel_and_stops_in_1_33_s(parameters):
    plant = Plant(parameters, 180.0 * ROLLING, 180.0)
    while plant.wheel_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
    assert plant.time_s == pytest.approx(0.33, abs=0.01)
    while plant.road_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
    assert plant.time_s == pytest.approx(1.33, abs=0.01)
    assert plant.road_angle * parameters.r2 == pytest.approx(11.74, abs=0.05)


def test_locked_stop_follows_its_closed_form(parameters, paper):
    k = parameters
    plant = Plant(k, 100.0, 120.0)
    while plant.wheel_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
    locked_s, locked_rad, locked_rad_s = plant.time_s, plant.road_angle, plant.road_speed
    constant_rad_s2 = (paper.locked_normal_force() * k.r2 * paper.mu(1.0) + k.M20) / k.J2
    viscous_per_s = k.d2 / k.J2
    limit_rad_s = constant_rad_s2 / viscous_per_s
    for share in (0.25, 0.5, 0.95):
        plant.advance(0.0, 1.0, locked_s + share * locked_rad_s / constant_rad_s2 - plant.time_s)
        elapsed_s = plant.time_s - locked_s
        speed_rad_s = (locked_rad_s + limit_rad_s) * math.exp(-viscous_per_s * elapsed_s) - limit_rad_s
        angle_rad = (locked_rad_s - speed_rad_s) / viscous_per_s - limit_rad_s * elapsed_s
        assert plant.road_speed == pytest.approx(speed_rad_s, abs=1e-6)
        assert plant.road_angle - locked_rad == pytest.approx(angle_rad, abs=1e-5)
    while plant.road_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
    stop_s = math.log1p(locked_rad_s / limit_rad_s) / viscous_per_s
    assert plant.time_s - locked_s == pytest.approx(stop_s, abs=0.0006)


@pytest.mark.parametrize("start_rad_s", [180.0, 120.0, 60.0])
def test_stop_with_the_slip_held_at_0_2(mask, start_rad_s):
    k = replace(mask, c31=math.inf)
    plant = Plant(k, 0.8 * ROLLING * start_rad_s, start_rad_s)

    def slip_rate(torque_nm):
        x1, x2 = plant.wheel_speed, plant.road_speed
        motion = accelerations(x1, x2, torque_nm, 0.0, k)
        return k.r1 / (k.r2 * x2) * (x1 / x2 * motion.road_acceleration - motion.wheel_acceleration)

    duty = 0.0
    while plant.road_speed > 0.0:
        assert plant.time_s < 3.0
        if plant.road_speed > 2.0:
            assert plant.slip == pytest.approx(0.2, abs=0.002)
            held = slip_rate(0.0)
            duty = brake_duty((-20.0 * (plant.slip - 0.2) - held) / (slip_rate(1.0) - held), k)
        plant.advance(0.0, duty, 0.0005)
    assert plant.time_s == pytest.approx(start_rad_s / 136.2, rel=0.01)
    assert plant.road_angle * k.r2 == pytest.approx(start_rad_s**2 * 0.099 / (2 * 136.2), rel=0.01)


def test_full_brake_from_equal_speeds_passes_through_rolling_and_then_locks(mask):
    plant = Plant(replace(mask, c31=VENDOR_LAG), 180.0, 180.0)
    assert plant.parameters.r1 * plant.wheel_speed > plant.parameters.r2 * plant.road_speed
    slips = [plant.slip]
    while plant.wheel_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
        slips.append(plant.slip)
    turning = slips.index(min(slips))
    assert slips[0] == pytest.approx(0.0005 / 0.0995, rel=1e-9)
    assert slips[turning] < 0.001
    assert 0 < turning < 60
    assert slips[:turning] == sorted(slips[:turning], reverse=True)
    assert slips[turning:] == sorted(slips[turning:])
    assert slips[-1] == 1.0


@pytest.mark.parametrize(
    ("changed", "apart", "tolerance"),
    [({"c31": 20.37}, 0.0073, 6e-4), ({"c31": 10.37}, 0.29, 0.005), ({"w1": 0.04240011450454}, 0.118, 0.002)],
)
def test_full_brake_step_is_as_sensitive_as_published(mask, changed, apart, tolerance):
    vendor = full_brake_slips(mask, c31=VENDOR_LAG)
    other = full_brake_slips(mask, **{"c31": VENDOR_LAG, **changed})
    assert max(abs(a - b) for a, b in zip(vendor, other, strict=True)) == pytest.approx(apart, abs=tolerance)


@pytest.mark.parametrize("threshold", [0.1, 0.7])
def test_vendor_simulators_relay_stops_in_1_37_to_1_38_s_at_its_threshold(mask, threshold):
    plant = Plant(replace(mask, c31=VENDOR_LAG, u0=VENDOR_U0), 180.0, 180.0)
    slips = []
    while plant.road_speed > 0.0:
        plant.advance(0.0, 1.0 if plant.slip < threshold else 0.0, 0.01)
        if 0.5 < plant.time_s < 1.0:
            slips.append(plant.slip)
    assert 1.365 <= plant.time_s <= 1.385
    assert min(slips) < threshold < max(slips)
    assert max(abs(slip - threshold) for slip in slips) < 0.1
