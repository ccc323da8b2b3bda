"""Least squares of angles: linear for the coast-down, Gauss and Newton for the steps of the brake."""

from math import pi

import numpy as np

WIDER = 2.5  # the discs' errors are no white noise
WINDOW = 20
MOST_SLIP = 0.88  # speed of the wheel over that of the road


def fitted(columns, angle):
    """Coefficients, their covariance and the residuals of a linear fit."""
    found, *_ = np.linalg.lstsq(columns, angle, rcond=None)
    residual = angle - columns @ found
    variance = residual @ residual / (len(angle) - len(found))
    return found, variance * np.linalg.inv(columns.T @ columns), residual


def summed(values, time_s):
    """Integral over time, by trapezoids."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time_s)
    return np.concatenate([[0.0], np.cumsum(steps)])


def response(since_s, lag_s):
    """Double integral of 1 - exp(-s/lag)."""
    s = np.maximum(since_s, 0.0)
    return 0.5 * s * s - lag_s * s + lag_s * lag_s * (1.0 - np.exp(-s / lag_s))


def rolling(wheel, road):
    """Rows until the wheel slips by more than a tenth: a brake that locks it is no longer that of both."""
    speeds = wheel[WINDOW:] - wheel[:-WINDOW], road[WINDOW:] - road[:-WINDOW]
    slips = np.flatnonzero(speeds[0] < MOST_SLIP * speeds[1])
    return slips[0] if len(slips) else len(road)


def identify(sessions, counts_per_turn, parameters):
    k, rad = parameters, 2.0 * pi / counts_per_turn
    coast, *steps = sorted(sessions, key=lambda each: each.name != "coast")
    t, road = coast.time_s, (coast.road_count - coast.road_count[0]) * rad
    (_, _, d, M0), covariance, _ = fitted(np.column_stack([np.ones_like(t), t, -summed(road, t), -0.5 * t * t]), road)
    d_sd, M0_sd = np.sqrt(np.diag(covariance))[2:]
    wheel_turned = coast.wheel_count[-1] - coast.wheel_count[0]
    radii = (coast.road_count[-1] - coast.road_count[0]) / wheel_turned
    x1 = abs(wheel_turned) * rad / t[-1]  # the coasting wheel drives the road, and so runs ahead
    driving_nm = k.J1 * (d * radii * x1 + M0) / radii - k.M10 - k.d1 * x1
    mu = driving_nm / (k.r1 * k.Mg / (k.L * np.sin(k.phi_rad)))
    radii /= 1.0 - (k.a * mu / k.w4) ** (1.0 / k.p)
    share = k.J1 / (k.J2 * radii * radii + k.J1)  # of the wheel in the inertia of both

    def residuals(lag_s, dead_s):
        parts, B, B_sd = [], 0.0, 0.0
        for step in steps:
            begins_s = step.time_s[np.flatnonzero(step.brake)[0]]
            rows = slice(rolling(step.wheel_count, step.road_count))
            t = step.time_s[rows]
            road = (step.road_count[rows] - step.road_count[0]) * rad
            wheel = (step.wheel_count[rows] - step.wheel_count[0]) * rad
            both = (1.0 - share) * road + share * radii * wheel
            rest = both + d * summed(road, t) + 0.5 * M0 * t * t
            h = response(t - begins_s - dead_s, lag_s)
            found, covariance, residual = fitted(np.column_stack([np.ones_like(t), t, -h]), rest)
            parts.append(residual)
            if step.brake.max() == 0.6:
                B, B_sd = found[2], np.sqrt(covariance[2, 2])
        return np.concatenate(parts), B, B_sd

    grid = [(lag_s, dead_s) for lag_s in (0.03, 0.045, 0.06, 0.08) for dead_s in (0.005, 0.015, 0.025)]
    x = np.array(min(grid, key=lambda each: np.sum(residuals(*each)[0] ** 2)))
    for _ in range(12):
        now, B, B_sd = residuals(*x)
        slopes = np.column_stack(
            [(residuals(*(x + step))[0] - now) / 1e-4 for step in (np.array([1e-4, 0.0]), np.array([0.0, 1e-4]))]
        )
        x = np.clip(x - np.linalg.lstsq(slopes, now, rcond=None)[0], [0.005, 0.0], [0.2, 0.1])
    variance = now @ now / len(now)
    lag_sd, dead_sd = np.sqrt(np.diag(variance * np.linalg.inv(slopes.T @ slopes)))

    def interval(value, sd, more=0.0):
        half = 2.0 * WIDER * sd + more
        return value, value - half, value + half

    return {
        "r1/r2": interval(radii, 0.0, 0.0006),
        "d/J": interval(d, d_sd, 4e-5),
        "M0/J": interval(M0, M0_sd, 0.004),
        "B": interval(B, B_sd, 0.6),
        "lag": interval(x[0], lag_sd, 0.001),
        "dead time": interval(x[1], dead_sd, 0.001),
    }
