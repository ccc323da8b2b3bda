import statistics

import pytest

from inteco_abs.rig.rng import SplitMix64, normal_pair


@pytest.mark.parametrize(
    ("seed", "words"),
    [
        (0, [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]),
        (1234567, [6457827717110365317, 3203168211198807973, 9817491932198370423]),
    ],
)
def test_words_are_those_that_are_published_for_splitmix64(seed, words):
    generator = SplitMix64(seed)
    assert [generator.word() for _ in words] == words


def test_uniform_numbers_stay_in_their_range_and_fill_it():
    generator = SplitMix64(1)
    numbers = [generator.uniform(-2.0, 3.0) for _ in range(4000)]
    assert -2.0 <= min(numbers) < -1.99
    assert 2.99 < max(numbers) < 3.0
    assert statistics.fmean(numbers) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("seed", [-1, 1 << 64])
def test_a_seed_that_is_not_a_64_bit_word_is_refused(seed):
    with pytest.raises(ValueError, match=rf"seed = {seed}: must be in 0\.\.2\^64-1"):
        SplitMix64(seed)


def test_normal_pairs_are_normal_and_independent():
    pairs = [normal_pair(7, index) for index in range(4000)]
    for numbers in zip(*pairs, strict=True):
        assert statistics.fmean(numbers) == pytest.approx(0.0, abs=0.06)
        assert statistics.stdev(numbers) == pytest.approx(1.0, abs=0.04)
        assert 3.0 < max(abs(number) for number in numbers) < 6.7
    assert statistics.correlation(*zip(*pairs, strict=True)) == pytest.approx(0.0, abs=0.06)
    first = [pair[0] for pair in pairs]
    assert statistics.correlation(first[1:], first[:-1]) == pytest.approx(0.0, abs=0.06)


def test_a_normal_pair_depends_on_its_seed_and_number_alone():
    assert normal_pair(7, 3) == normal_pair(7, 3)
    assert len({normal_pair(seed, index) for seed in range(10) for index in range(10)}) == 100
