import math
from dataclasses import FrozenInstanceError

import pytest

from inteco_abs.rig import RigParameters

COMMON = {
    "r1": 0.0995,
    "r2": 0.099,
    "phi_rad": 65.61 * math.pi / 180,
    "L": 0.370,
    "J1": 7.5281e-3,
    "J2": 25.603e-3,
    "Mg": 19.6181,
    "w1": -0.04240011450454,
    "w2": 2.9375e-10,
    "w3": 0.03508217905067,
    "w4": 0.40662691102315,
    "a": 0.00025724985785,
    "p": 2.09945271667129,
    "c31": 20.37,
    "b1": 15.24,
    "b2": -6.21,
    "u0": 0.415,
}
FRICTION = {
    "mask": {"d1": 1.2e-4, "d2": 2.25e-4, "M10": 0.003, "M20": 0.093},
    "table": {"d1": 1.1874e-4, "d2": 2.1468e-4, "M10": 0.0032, "M20": 0.0925},
}


@pytest.mark.parametrize("name", ["mask", "table"])
def test_published_set(name):
    found = RigParameters.named(name)
    published = COMMON | FRICTION[name]
    assert {symbol: getattr(found, symbol) for symbol in published} == pytest.approx(published, rel=1e-15, abs=0.0)
    assert set(found.__dataclass_fields__) == set(published)


@pytest.mark.parametrize("name", ["", "Mask", "simulator"])
def test_an_unknown_set_is_refused_with_the_known_ones(name):
    with pytest.raises(ValueError, match=f"'{name}': must be one of mask, table"):
        RigParameters.named(name)


def test_a_set_cannot_be_changed_for_everyone(mask):
    with pytest.raises(FrozenInstanceError):
        mask.r1 = 1.0
