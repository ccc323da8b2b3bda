"""C of the rig's functions: the same bits as in Python, and what it refuses."""

import ctypes
import math
import random
import struct
from dataclasses import astuple, dataclass, fields

import pytest

from inteco_abs.c_code import compiled_c, structure, structured, translated
from inteco_abs.errors import AbsError
from inteco_abs.rig import POPULATIONS, RigParameters, RigVariation, draw
from inteco_abs.rig.model import wheel_slip
from inteco_abs.rig.plant import move_on, read_encoders
from inteco_abs.rig.state import Constants, State

ROOM = 8


class Row(ctypes.Structure):
    _fields_ = (("at", ctypes.POINTER(ctypes.c_double)), ("size", ctypes.c_int64))


class Counts(ctypes.Structure):
    _fields_ = (("wheel", ctypes.c_int64), ("road", ctypes.c_int64))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    file = tmp_path_factory.mktemp("c") / "rig.so"
    compiled_c(translated([move_on, read_encoders, wheel_slip]), file)
    found = ctypes.CDLL(str(file))
    number, rig, state = ctypes.c_double, ctypes.POINTER(structure(Constants)), ctypes.POINTER(structure(State))
    found.move_on.argtypes = (rig, state, Row, Row, number, number, number)
    found.move_on.restype = None
    found.read_encoders.argtypes, found.read_encoders.restype = (rig, state, ctypes.c_int64), Counts
    found.wheel_slip.argtypes = (number, number, ctypes.POINTER(structure(RigParameters)))
    found.wheel_slip.restype = number
    return found


def drawn_rig(random_):
    if random_.random() < 0.1:
        return Constants.of(RigVariation(), max_step_s=0.0005)
    return Constants.of(draw(random_.choice(POPULATIONS), random_.getrandbits(64)), max_step_s=0.0005)


def drawn_speed(random_):
    """From run-up to standstill, and backwards, which a wheel must survive too."""
    return random_.choice((0.0, -0.0, 1.0, 1e-4, -1.0)) * random_.choice((0.004, 0.2, 20.0, 250.0)) * random_.random()


def drawn_state(random_, k):
    s = State.at_speeds(k, drawn_speed(random_), drawn_speed(random_))
    s.brake_torque, s.settled_torque = random_.choice((0.0, 9.0)) * random_.random(), 9.0 * random_.random()
    s.wheel_angle, s.road_angle = random_.uniform(-1e4, 1e4), random_.uniform(-1e7, 1e7)
    return s


def bits(*records):
    """Of numbers; a NaN is one too."""
    return b"".join(struct.pack("<d", value) for record in records for value in record)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 4))])
def test_c_moves_and_reads_drawn_rigs_from_drawn_states_as_python_does(library, seed):
    random_ = random.Random(seed)
    for _ in range(100):
        k = drawn_rig(random_)
        s, due_s, torques = drawn_state(random_, k), [0.0] * ROOM, [0.0] * ROOM
        in_c, k_in_c = structured(s), structured(k)
        times, torques_in_c = (ctypes.c_double * ROOM)(), (ctypes.c_double * ROOM)()
        for reading in range(1, ROOM):
            drive, brake = random_.choice(((0.0, random_.random()), (random_.random(), 0.0), (0.0, 0.0), (1.0, 1.0)))
            duration_s = random_.choice((0.0005, 0.0005, 0.004, random_.uniform(0.0, 0.02)))
            move_on(k, s, due_s, torques, drive, brake, duration_s)
            library.move_on(k_in_c, in_c, Row(times, ROOM), Row(torques_in_c, ROOM), drive, brake, duration_s)
            moved = [getattr(in_c, field.name) for field in fields(s)]
            assert bits(astuple(s), due_s, torques) == bits(moved, times, torques_in_c)
            counts = library.read_encoders(k_in_c, in_c, reading)
            assert (counts.wheel, counts.road) == read_encoders(k, s, reading)


def test_a_function_for_two_kinds_of_records_is_translated_for_each(library):
    parameters = RigParameters.named("table")
    in_c = structured(parameters)
    for speeds in ((1.0, 2.0), (-1.0, 2.0), (0.0, 0.0), (-3.0, -2.5)):
        assert bits([library.wheel_slip(*speeds, ctypes.byref(in_c))]) == bits([wheel_slip(*speeds, parameters)])
    assert "double friction_formula__of_2(" in translated([move_on])


@dataclass(slots=True)
class Tank:
    """State of the functions that follow."""

    level: float = 0.0
    name: str = ""


@dataclass(slots=True)
class Level:
    value: float = 0.0


def squared(x: float) -> float:
    return x**2


def floored(x: int) -> int:
    return x // 2


def two_types(x: float) -> float:
    y = 1
    y += x
    return y


def two_returns(x: float) -> float:
    if x > 0.0:
        return 1
    return x


def filled(s: Level, x: float) -> float:
    s.value += x
    return x


def two_changes(s: Level, x: float) -> float:
    return s.value * filled(s, x)


def caught(x: float) -> float:
    try:
        return 1.0 / x
    except ZeroDivisionError:
        return 0.0


def listed(x: float) -> float:
    return sum([x, x])


def library_sine(x: float) -> float:
    return math.sin(x)


def again(x: float) -> float:
    return again(x) if x > 1.0 else x


def by_name(x: float, n: int = 1) -> float:
    return x * n


def default_used(x: float) -> float:
    return by_name(x)


def word_of_c(x: float) -> float:
    register = x
    return register + x


def from_the_end(x: list[float]) -> float:
    return x[-1]


def named(s: Tank) -> float:
    return s.level


def least_of_both(x: float, n: int) -> float:
    return min(x, n)


def without_compare(x: float) -> bool:
    return x is None


@pytest.mark.parametrize(
    "function",
    [
        squared, floored, two_types, two_returns, two_changes, caught, listed, library_sine, default_used, word_of_c,
        from_the_end, least_of_both, without_compare,
    ],
)  # fmt: skip
def test_untranslatable_code_is_refused_with_its_line(function):
    first = function.__code__.co_firstlineno
    with pytest.raises(AbsError, match="cannot be translated to C") as refused:
        translated([function])
    file, line = str(refused.value).split(", line ")
    assert file == __file__
    line = int(line.partition(":")[0])
    assert first <= line <= first + 6 or line == by_name.__code__.co_firstlineno


def test_a_function_that_calls_itself_is_refused():
    with pytest.raises(AbsError, match="again calls itself"):
        translated([again])


def test_without_a_compiler_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(AbsError, match="install one"):
        compiled_c("int a;", tmp_path / "a.so")


def test_what_the_compiler_reports_is_in_the_error(tmp_path):
    with pytest.raises(AbsError, match="cc failed with exit code 1") as failed:
        compiled_c("int a = nothing;", tmp_path / "a.so")
    assert "nothing" in str(failed.value)
