"""Encoders jump, which no wheel does; drive and brake show in the road's acceleration, later."""

from collections import deque
from math import pi

SHORT = 6  # samples in a window of speed
LONG = 120  # samples between two speeds of an acceleration
JUMP = 8.0  # rad/s that no wheel changes within two short windows
FAST = 30.0  # rad/s


class Monitor:
    def __init__(self, counts_per_turn, parameters, period_s):
        self.rad_per_count, self.period_s = 2.0 * pi / counts_per_turn, period_s
        self.counts = {"wheel": deque(maxlen=2 * SHORT + 1), "road": deque(maxlen=2 * SHORT + 1)}
        self.speeds = deque(maxlen=LONG)
        self.driving_s = self.braking_s = self.slowing_s = 0.0
        self.suspect, self.waited = "", 0

    def update(self, sample, command):
        self.counts["wheel"].append(sample.wheel_count)
        self.counts["road"].append(sample.road_count)
        return self.encoder() or ("" if self.suspect else self.actuator(command, sample.dt_s))

    def encoder(self):
        if len(self.counts["road"]) <= 2 * SHORT:
            return ""
        for name, counts in self.counts.items():
            before, now = self.speed(counts, 0), self.speed(counts, SHORT)
            if not self.suspect and before > FAST and before - now > JUMP and now < 0.9 * before:
                self.suspect, self.waited, self.before = name, 0, before
        if not self.suspect:
            return ""
        self.waited += 1
        if self.waited < SHORT:  # until all of the newer window is of the broken encoder
            return ""
        share = self.speed(self.counts[self.suspect], SHORT) / self.before
        return f"{self.suspect}-{'reversed' if share < -0.1 else 'stuck' if share < 0.1 else 'slips'}"

    def speed(self, counts, first):
        return (counts[first + SHORT] - counts[first]) * self.rad_per_count / (SHORT * self.period_s)

    def actuator(self, command, dt_s):
        road = self.counts["road"]
        if len(road) > SHORT:
            self.speeds.append(self.speed(road, len(road) - 1 - SHORT))
        self.driving_s = self.driving_s + dt_s if command.drive > 0.5 else 0.0
        self.braking_s = self.braking_s + dt_s if command.brake > 0.58 else 0.0
        if len(self.speeds) < LONG:
            return ""
        half = LONG // 2
        first, second = (sum(list(self.speeds)[place : place + half]) / half for place in (0, half))
        acceleration = (second - first) / (half * self.period_s)
        if self.driving_s > 0.08:
            if acceleration < -25.0:
                return "brake-stuck"
            self.slowing_s = self.slowing_s + dt_s if acceleration < -1.5 else 0.0
            if self.slowing_s > 0.12:
                return "drive-dead"
        else:
            self.slowing_s = 0.0
        if self.braking_s > 0.2 and acceleration > -20.0:
            return "brake-dead"
        return ""
