import math
import statistics
from dataclasses import replace

import pytest

from inteco_abs.rig import Encoder, EncoderVariation, RigVariation

TURN = 2.0 * math.pi


def encoder(wheel=True, seed=0, **disc):
    discs = {"wheel_encoder": EncoderVariation(**disc), "road_encoder": EncoderVariation(**disc)}
    return Encoder(RigVariation(seed=seed, **discs), wheel=wheel)


@pytest.mark.parametrize(("angle_rad", "count"), [(0.0, 0), (TURN, 2048), (0.9 * TURN / 2048, 0), (-1e-6, -1)])
def test_an_ideal_encoder_counts_the_lines_that_were_passed(angle_rad, count):
    assert encoder(counts_per_turn=2048).read(angle_rad + 1e-9, 0.0) == count


def test_the_wheel_starts_between_two_lines_at_the_given_angle():
    disc = encoder(counts_per_turn=1024, edge_counts=0.75)
    assert [disc.read(counts * TURN / 1024, 0.0) for counts in (0.0, 0.2, 0.3, 1.2)] == [0, 0, 1, 1]


def test_an_eccentric_disc_is_wrong_by_its_eccentricity_once_per_turn():
    disc = encoder(counts_per_turn=2048, edge_counts=0.5, eccentricity_counts=10.0, eccentricity_phase_rad=0.3)
    errors = [disc.read(share * TURN, 0.0) - share * 2048 for share in (i / 64 for i in range(128))]
    wanted = [10.0 * math.sin(share * TURN + 0.3) for share in (i / 64 for i in range(128))]
    assert errors == pytest.approx(wanted, abs=0.51)


def test_jitter_has_its_standard_deviation():
    disc = encoder(edge_counts=0.5, jitter_counts=5.0)
    counts = [disc.read(0.0, 0.0) for _ in range(4000)]
    assert statistics.stdev(counts) == pytest.approx(math.hypot(5.0, math.sqrt(1 / 12)), rel=0.05)
    assert statistics.fmean(counts) == pytest.approx(0.0, abs=0.3)


def test_noise_is_that_of_the_seed_and_of_the_readings_number():
    counts = [
        [disc.read(0.0, 0.0) for _ in range(20)] for disc in (encoder(seed=5, jitter_counts=5.0) for _ in range(2))
    ]
    assert counts[0] == counts[1]
    assert counts[0] != [disc.read(0.0, 0.0) for disc in [encoder(seed=6, jitter_counts=5.0)] for _ in range(20)]


def test_the_two_encoders_of_a_rig_do_not_share_their_noise():
    wheel, road = encoder(jitter_counts=5.0), encoder(wheel=False, jitter_counts=5.0)
    pairs = [(wheel.read(0.0, 0.0), road.read(0.0, 0.0)) for _ in range(2000)]
    assert statistics.correlation(*zip(*pairs, strict=True)) == pytest.approx(0.0, abs=0.08)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("counts_per_turn", 15),
        ("edge_counts", 1.1),
        ("eccentricity_counts", -0.1),
        ("eccentricity_phase_rad", math.inf),
        ("jitter_counts", math.nan),
    ],
)
def test_values_out_of_range_are_refused_by_name(name, bad):
    with pytest.raises(ValueError, match=rf"{name} = {bad!r}: must be"):
        replace(EncoderVariation(), **{name: bad})
