"""The procedure on the mock with a scripted operator: questions, answers, and what goes over the link."""

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from firmware_protocol.rtdac_usb2 import READ_REQUEST, decode_send
from inteco_abs.boards import Link
from inteco_abs.commissioning import MockRigAccess, Procedure, ProfileDraft
from inteco_abs.commissioning.rig_access import TURNS
from inteco_abs.commissioning.step import StepContext
from inteco_abs.config import parse_config

ECHO_PHRASE = "the power interface is off"
MOTORS_PHRASE = "the cover is closed, my hand is at the emergency switch"
SCRIPTS = {
    "list": [""],
    "header": [""],
    "reads": [""],
    "wheels": ["", "", ""],
    "echo": ["", ECHO_PHRASE, "yes"],
    "motors": ["", MOTORS_PHRASE, "", ""],
    "sign": ["", "the lab", "yes"],
}
"""Answers with which each step comes out well on a rig that is wired as the vendor's."""
ODD = (
    "simulation.road_encoder=5",
    "simulation.wheel_encoder=2",
    "simulation.wheel_sign=-1",
    "simulation.counts_per_turn=2048",
    "simulation.drive_pwm=1",
    "simulation.brake_pwm=0",
)


class NoAnswerLeftError(Exception):
    """There are no more answers."""


class ScriptedOperator:
    """Answers from a list. An answer that is an exception is raised, one that is a function is called."""

    def __init__(self, answers: Iterable[str | BaseException | Callable[[], str]]) -> None:
        self.answers = list(answers)
        self.asked: list[str] = []
        self.said: list[str] = []

    def say(self, text: str) -> None:
        self.said.append(text)

    def show(self, text: str) -> None:
        pass

    def ask(self, question: str) -> str:
        self.asked.append(question)
        if not self.answers:
            raise NoAnswerLeftError(question)
        answer = self.answers.pop(0)
        if isinstance(answer, BaseException):
            raise answer
        return answer if isinstance(answer, str) else answer()

    def heard(self, text: str) -> bool:
        return any(text in line for line in self.said)


class WatchedLink(Link):
    """Keeps what is written, and fails from a given write on."""

    def __init__(self, rig: "WatchedRig", inner: Link) -> None:
        self._rig = rig
        self._inner = inner

    def write(self, data):
        self._rig.written.append(bytes(data))
        self._rig.before_write(len(self._rig.written))
        self._inner.write(data)

    def read(self, length):
        return self._rig.change_answer(self._inner.read(length))

    def close(self):
        self._inner.close()


class WatchedRig(MockRigAccess):
    """The mock rig, whose hands, link and time a test may watch and disturb."""

    def __init__(self, config) -> None:
        super().__init__(config)
        self.written: list[bytes] = []
        self.before_write: Callable[[int], None] = lambda _number: None
        self.change_answer: Callable[[bytes], bytes] = bytes
        self.hand: Callable[[str], None] = lambda which: self.device.turn(which, TURNS, 5.0)
        self.switch: Callable[[bool], None] = lambda on: self.device.power(on=on)
        self.largest = (0.0, 0.0)

    def link(self) -> Link:
        return WatchedLink(self, super().link())

    def held(self, config):
        return super().held(parse_config(config.to_toml()))  # as the process gets it that holds a real board

    def turned(self, which):
        self.hand(which)

    def powered(self, *, on):
        self.switch(on)

    def pause(self, seconds):
        super().pause(seconds)
        drive, brake = self.device.duties
        self.largest = max(self.largest[0], drive), max(self.largest[1], brake)

    @property
    def frames_sent(self) -> list[bytes]:
        return [message for message in self.written if message != READ_REQUEST]

    @property
    def settings_sent(self) -> list[dict[str, int]]:
        return [decode_send(frame) for frame in self.frames_sent]


class Lab:
    """A folder with a draft in it; each session is a new procedure on a board that is powered up again."""

    def __init__(self, folder) -> None:
        self.file = folder / "lab.toml"

    def session(self, *answers, settings=(), profile="usb2_generic_0103", quiet=False):
        """A procedure, not begun, with a operator who will give these answers."""
        self.draft = ProfileDraft.open(self.file, "sim:", profile, settings)
        self.operator = ScriptedOperator(answers)
        self.rig = WatchedRig(self.draft.config)
        self.procedure = Procedure(StepContext(self.rig, self.draft, self.operator, quiet))
        return self.procedure

    def done_until(self, step: str, settings=()) -> None:
        """As after a session with all steps before this one."""
        self.begin_with(files_after(list(SCRIPTS).index(step), tuple(settings)))

    def all_done(self) -> None:
        """As after a session with all steps, the signature among them."""
        self.begin_with(files_after(len(SCRIPTS), ()))

    def begin_with(self, files: dict[str, str]) -> None:
        """A new session in a folder with these files."""
        for name, text in files.items():
            self.file.with_name(name).write_text(text)
        self.session()

    def outcomes(self) -> dict[str, str]:
        return {one["name"]: one["outcome"] for one in self.procedure.state()}


@cache
def files_after(steps: int, settings: tuple[str, ...]) -> dict[str, str]:
    """Texts of the files by name after each number of steps: done once for all tests."""
    with TemporaryDirectory() as folder:
        lab = Lab(Path(folder))
        if steps:
            name = list(SCRIPTS)[steps - 1]
            lab.begin_with(files_after(steps - 1, settings))
            lab.session(*SCRIPTS[name]).go(only=name)
        else:
            lab.session(settings=settings)
        return {file.name: file.read_text() for file in Path(folder).iterdir()}


@pytest.fixture
def lab(tmp_path):
    return Lab(tmp_path)


@pytest.fixture(scope="session")
def scripts():
    return SCRIPTS


@pytest.fixture(scope="session")
def whole_script():
    return [answer for answers in SCRIPTS.values() for answer in answers]


@pytest.fixture(scope="session")
def odd():
    """Wiring of a rig on which nothing is as the vendor's."""
    return ODD
