"""Constants never change and a state has the fields that it declares: machine code and records rely on both."""

import importlib
import pkgutil

from inteco_abs import control

NAMES = [each.name for each in pkgutil.walk_packages(control.__path__, f"{control.__name__}.")]
PARTS = {
    kind
    for name in NAMES
    for kind in vars(importlib.import_module(name)).values()
    if isinstance(kind, type) and "__dataclass_params__" in vars(kind) and kind.__module__ in NAMES
}


def test_states_have_no_attributes_but_their_fields():
    assert len(PARTS) > 40
    assert [kind for kind in PARTS if "__slots__" not in vars(kind)] == []


def test_constants_are_frozen():
    constants = [kind for kind in PARTS if kind.__name__.endswith("Constants")]
    assert len(constants) > 15
    assert [kind for kind in constants if not kind.__dataclass_params__.frozen] == []
