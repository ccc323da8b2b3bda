"""The rig's FMU: FMPy finds nothing to object to, and its trajectories are the engine's, to the bit."""

import ctypes
import math
import re
import zipfile
from collections import deque
from itertools import pairwise

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from inteco_abs.c_code import compiled_c
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.interfaces.fmu import export_fmu
from inteco_abs.interfaces.fmu_variables import FMI_VERSIONS, MODEL, STEP_S, variables
from inteco_abs.rig import DriveMotor, Encoder, EncoderVariation, Plant, RigVariation, draw

OUTPUTS = ("wheel_count", "road_count", "wheel_speed", "road_speed", "slip", "brake_torque")
RIGS = {"2.0": draw("rough", 17), "3.0": draw("nominal", 3)}
"""With a brake that has no lag: the rate is infinite."""
HELD_STEPS = 40

pytestmark = pytest.mark.xdist_group("fmu")


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    found = {fmi: tmp_path_factory.mktemp("fmu") / f"rig{fmi[0]}.fmu" for fmi in FMI_VERSIONS}
    for fmi, path in found.items():
        export_fmu(path, RIGS[fmi], fmi=fmi)
    return found


@pytest.fixture(scope="module")
def unpacked(exported, tmp_path_factory):
    return {fmi: fmpy.extract(path, str(tmp_path_factory.mktemp("unpacked"))) for fmi, path in exported.items()}


DEFECTIVE = RigVariation(
    brake_dead_time_s=0.01,
    brake_release_ratio=2.0,
    brake_release_delay_s=0.005,
    brake_hysteresis_nm=0.3,
    brake_fade_per_kj=1.0,
    wheel_wear_per_kj=0.05,
    supply_sag=0.1,
    second_grip_step=-0.3,
    second_grip_step_after_s=0.1,
    road="snow",
    later_road="wet-cobblestone",
    later_road_after_s=0.2,
    latch_jitter_s=0.0002,
    drive_residual_nm=0.05,
    wheel_encoder=EncoderVariation(2048, 0.3, 0.5, 1.0, 0.3, 0.4, 2.0, 4.0, 1.0, 0.02),
)


def engine(rig, speeds, duties):
    """Outputs at the start and after each step of scalar plant and encoders, commands the rig's delay late."""
    plant, wheel, road = Plant(rig, *speeds), Encoder(rig, wheel=True), Encoder(rig, wheel=False)
    late, rows = deque([(0.0, 0.0)] * rig.command_delay_ticks), []
    for sent in [None, *duties]:
        if sent is not None:
            late.append(sent)
            plant.advance(*late.popleft(), STEP_S)
        counts = wheel.read(plant.wheel_angle, plant.wheel_speed), road.read(plant.road_angle, plant.road_speed)
        rows.append((*counts, plant.wheel_speed, plant.road_speed, plant.slip, plant.brake_torque))
    return rows


def a_stop(steps=2400):
    """Duties of a run-up, of braking in changing steps, below 60 rad/s down to standstill, and of a run-up again."""
    held = [(1.0, 0.0)] * 3 + [(0.0, 0.45 + 0.05 * (i % 7)) for i in range(50)] + [(0.7, 0.0)] * 7
    return [duty for duty in held for _ in range(HELD_STEPS)][:steps]


def as_signal(duties):
    """For FMPy, which draws straight lines between points: at each step from the duty before to the one after."""
    rows = [(i * STEP_S, *duty) for i, pair in enumerate(pairwise([duties[0], *duties])) for duty in pair]
    return np.array(rows, [("time", float), ("drive_duty", float), ("brake_duty", float)])


def start_values(rig, speeds):
    """All parameters of a rig."""
    own = {v.name: v.start for v in variables(rig, DriveMotor()) if v.causality == "parameter"}
    return {**own, "initial_wheel_speed": speeds[0], "initial_road_speed": speeds[1]}


def simulated(path, rig, speeds, duties):
    result = fmpy.simulate_fmu(
        str(path), stop_time=len(duties) * STEP_S, output_interval=STEP_S, start_values=start_values(rig, speeds),
        input=as_signal(duties), output=OUTPUTS,
    )  # fmt: skip
    return list(zip(*(result[name] for name in OUTPUTS), strict=True))


def same_bits(found, expected):
    return np.array(found, dtype=float).tobytes() == np.array(expected, dtype=float).tobytes()


@pytest.mark.long
@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_fmpys_validation_finds_nothing(exported, fmi):
    assert validate_fmu(str(exported[fmi])) == []


@pytest.mark.parametrize(
    ("fmi", "rig", "speeds"),
    [
        ("2.0", RigVariation(), (0.0, 0.0)),
        ("2.0", draw("rough", 17), (59.0, 60.0)),
        ("3.0", draw("nominal", 3), (50.0, 60.0)),
        ("3.0", draw("late", 1 << 63 | 5), (60.0, 60.0)),
        ("3.0", DEFECTIVE, (60.0, 60.0)),
    ],
    ids=["published", "rough", "nominal", "late", "defective"],
)
def test_a_trajectory_in_fmpy_is_the_engines_to_the_bit(exported, fmi, rig, speeds):
    duties = a_stop()
    found, expected = simulated(exported[fmi], rig, speeds, duties), engine(rig, speeds, duties)
    assert len(found) == len(expected)
    assert same_bits(found, expected)


@pytest.mark.long
@pytest.mark.parametrize("population", ["nominal", "hard", "rough", "late", "slow", "capped"])
def test_trajectories_of_drawn_rigs_are_the_engines_to_the_bit(exported, population):
    for seed in range(20):
        rig, speeds, duties = draw(population, seed), (9.0 * seed, 180.0), a_stop()
        assert same_bits(simulated(exported["3.0"], rig, speeds, duties), engine(rig, speeds, duties))


class Instance:
    """An instance in FMPy, by names."""

    def __init__(self, fmi, folder, token=None):
        description = fmpy.read_model_description(folder)
        kind = FMU2Slave if fmi == "2.0" else FMU3Slave
        self.fmu = kind(
            guid=token or description.guid, unzipDirectory=folder, modelIdentifier=MODEL, instanceName="one"
        )
        self.second, self.messages = fmi == "2.0", []
        self._variables = {v.name: v for v in description.modelVariables}
        self._instantiate()

    def _instantiate(self):
        if self.second:
            callbacks = fmpy.fmi2.fmi2CallbackFunctions()
            log = fmpy.fmi2.fmi2CallbackLoggerTYPE
            callbacks.logger = log(lambda *given: self.messages.append(given[4].decode()))
            self.fmu.instantiate(callbacks=callbacks)
        else:
            self.fmu.instantiate(logMessage=lambda *given: self.messages.append(given[3].decode()))

    def initialise(self):
        if self.second:
            self.fmu.setupExperiment()
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values):
        for name, value in values.items():
            self._access("set", name)([self._variables[name].valueReference], [value])

    def get(self, *names):
        return tuple(self._access("get", name)([self._variables[name].valueReference])[0] for name in names)

    def _access(self, verb, name):
        return getattr(self.fmu, verb + self._variables[name].type)

    def run(self, duties):
        rows = [self.get(*OUTPUTS)]
        for drive, brake in duties:
            self.set(drive_duty=drive, brake_duty=brake)
            self.fmu.doStep(0.0, STEP_S)
            rows.append(self.get(*OUTPUTS))
        return rows

    def state(self, verb, *given):
        """FMI 2.0 and 3.0 write this word differently."""
        return getattr(self.fmu, verb + ("FMUstate" if self.second else "FMUState"))(*given)

    def close(self):
        self.fmu.freeInstance()


@pytest.fixture(params=FMI_VERSIONS)
def new(request, unpacked):
    """Makes instances, which the test's end frees."""
    made = []

    def make(token=None):
        made.append(Instance(request.param, unpacked[request.param], token))
        return made[-1]

    make.rig = RIGS[request.param]
    yield make
    for each in made:
        each.close()


def test_instances_do_not_know_of_each_other_and_a_reset_is_a_new_beginning(new):
    duties, (one, other) = a_stop(300), (new(), new())
    for each in (one, other):
        each.initialise()
    expected = engine(new.rig, (0.0, 0.0), duties)
    found = one.run(duties)
    assert same_bits(other.run(duties), expected)
    assert same_bits(found, expected)
    one.fmu.reset()
    one.set(initial_wheel_speed=50.0, initial_road_speed=60.0)
    one.initialise()
    assert same_bits(one.run(duties), engine(new.rig, (50.0, 60.0), duties))


def test_a_saved_state_goes_on_as_before_in_another_instance_too(new):
    duties, (one, other) = a_stop(400), (new(), new())
    one.initialise()
    one.run(duties[:200])
    saved = one.state("get")
    later = one.run(duties[200:])
    one.state("set", saved)
    assert same_bits(one.run(duties[200:]), later)
    kept = one.state("serialize", saved)
    one.state("free", saved)
    word = "deSerialize" if other.second else "deserialize"
    foreign = re.sub(rb"[0-9a-f]{8}-([0-9a-f]{4}-){3}", b"another-0000-0000-0000-", kept, count=1)
    with pytest.raises(FMICallException):
        other.state(word, foreign)
    restored = other.state(word, kept)
    other.state("set", restored)
    other.state("free", restored)
    assert same_bits(other.run(duties[200:]), later)


def test_a_long_step_is_many_short_ones(new):
    one, other = new(), new()
    for each in (one, other):
        each.initialise()
        each.set(drive_duty=1.0)
    one.fmu.doStep(0.0, 100 * STEP_S)
    for i in range(100):
        other.fmu.doStep(i * STEP_S, STEP_S)
    assert one.get("time", *OUTPUTS) == other.get("time", *OUTPUTS)
    assert one.get("time") == (100 * STEP_S,)


def test_outputs_are_those_of_the_parameters_before_the_first_step(new):
    one = new()
    one.set(initial_wheel_speed=90.0, initial_road_speed=100.0)
    assert same_bits([one.get(*OUTPUTS)], engine(new.rig, (90.0, 100.0), []))


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("brake_duty", 1.01, "brake_duty = 1.01"),
        ("drive_duty", math.nan, "drive_duty = nan"),
        ("J1", 0.0, "J1 = 0: must be in 1e-06..1e+06"),
        ("adhesion_scale", 2.1, "must be in 0.1..2"),
        ("wheel_encoder.counts_per_turn", 15, "must be in 16..1e+06"),
        ("slip", 0.1, "only inputs can be set"),
    ],
)
def test_a_wrong_value_is_refused_with_its_range_and_changes_nothing(new, name, value, says):
    one = new()
    before = one.get(name)
    with pytest.raises(FMICallException):
        one.set(**{name: value})
    assert says in one.messages[-1]
    assert one.get(name) == before


def test_what_comes_at_the_wrong_time_is_refused(new):
    one = new()
    with pytest.raises(FMICallException):
        one.fmu.doStep(0.0, STEP_S)
    one.initialise()
    with pytest.raises(FMICallException):
        one.set(J1=0.01)
    assert "parameters before the initialisation ends" in one.messages[-1]
    with pytest.raises(FMICallException):
        one.fmu.doStep(0.0, 1.5 * STEP_S)
    assert "must be a multiple of 0.0005 s" in one.messages[-1]
    assert one.get("time") == (0.0,)


def test_a_rig_that_cannot_be_stops_with_an_error(new):
    one = new()
    one.set(J1=1e-6, J2=1e-6, Mg=1e6, L=1e-6, initial_road_speed=100.0, initial_wheel_speed=50.0)
    one.initialise()
    one.set(brake_duty=1.0)
    with pytest.raises(FMICallException):
        one.fmu.doStep(0.0, 4000 * STEP_S)
    assert "the parameters fit no rig" in one.messages[-1]


def test_a_binary_refuses_the_description_of_another_one(unpacked):
    with pytest.raises(Exception, match=r"instantiat"):
        Instance("2.0", unpacked["2.0"], "{00000000-0000-0000-0000-000000000000}")


def test_the_source_inside_compiles_with_prefixed_names(exported, tmp_path):
    with zipfile.ZipFile(exported["3.0"]) as archive:
        source = archive.read(f"sources/{MODEL}.c").decode()
        assert not any(b"libpython" in archive.read(name) for name in archive.namelist())
    compiled_c(source, tmp_path / "own.so", "-DFMI3_FUNCTION_PREFIX=own_", "-DFMI2_FUNCTION_PREFIX=own_", "-O0")
    own = ctypes.CDLL(str(tmp_path / "own.so"))
    own.own_fmi3GetVersion.restype = own.own_fmi2GetVersion.restype = ctypes.c_char_p
    assert (own.own_fmi3GetVersion(), own.own_fmi2GetVersion()) == (b"3.0", b"2.0")


def test_the_same_rig_gives_the_same_file(exported, tmp_path):
    export_fmu(tmp_path / "again.fmu", RIGS["2.0"], fmi="2.0")
    assert (tmp_path / "again.fmu").read_bytes() == exported["2.0"].read_bytes()


def test_numbers_of_the_rig_are_the_parameters_start_values_with_units_and_meanings(exported):
    description = fmpy.read_model_description(str(exported["2.0"]))
    found = {v.name: v for v in description.modelVariables}
    assert float(found["J1"].start) == RIGS["2.0"].parameters.J1
    assert (found["J1"].unit, found["J1"].description) == ("kg.m2", "Moment of inertia of the upper wheel, kg m2.")
    assert float(found["road_encoder.edge_counts"].start) == RIGS["2.0"].road_encoder.edge_counts
    assert all(v.description for v in found.values())
    assert {v.variability for v in found.values() if v.causality == "parameter"} == {"fixed"}


@pytest.mark.parametrize(
    ("rig", "fmi", "name", "says"),
    [
        (RigVariation(), "1.0", "rig.fmu", "must be one of 2.0, 3.0"),
        (RigVariation(), "3.0", "rig.zip", "must end in .fmu"),
        (RigVariation(seed=1 << 40), "2.0", "rig.fmu", "use FMI 3.0"),
        (RigVariation(), "3.0", "no/rig.fmu", "does not exist"),
    ],
)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(tmp_path, rig, fmi, name, says):
    with pytest.raises(AbsError, match=says):
        export_fmu(tmp_path / name, rig, fmi=fmi)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_kept(tmp_path):
    (tmp_path / "rig.fmu").write_text("mine")
    with pytest.raises(ConfigError, match="never overwritten"):
        export_fmu(tmp_path / "rig.fmu")
    assert (tmp_path / "rig.fmu").read_text() == "mine"
