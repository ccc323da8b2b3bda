"""Runs a user's controller in its own process: it answers the loop, and reaches neither board nor guard.

The loop asks and waits once a tick. The answer is numbers in fixed places, never code. The two share a CPU, with the
controller's priority just below the loop's: a pipe is quickest there (`tools/bench_isolation`), and the loop's wait
ends in time even if the controller hangs.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from copy import deepcopy
from pathlib import Path
from typing import IO, Any, Final, cast

from inteco_abs.control import CONTROLLERS, REFERENCE, Controller, Gain, Setup, demand_of, keeps_gain, set_gain
from inteco_abs.errors import BoardError, ConfigError, ConfigIssue, ControllerError, describe_error
from inteco_abs.plugins import FROM_FILE, LOADING_MOST_S, Controllers, late_files, load_controller, with_files
from inteco_abs.posix import PIPE_BUF, resource
from inteco_abs.quantities import quantities
from inteco_abs.realtime.heartbeat import NO_MORE
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.processes import ENTRY
from inteco_abs.realtime.tuning import apply, controller_tuning, end_with_parent
from inteco_abs.signals import BrakeDemand, Estimate, Prediction

_LOOK_MS: Final = 5
_LOOKS: Final = range(4)
"""Waits of 5 ms each: 20 ms are less than half of the guardian's window, which would kill the loop for the silence, and
a thousand times what a law needs. A pause of the computer uses up one look only."""
_DYING_S: Final = 0.005
"""Time from the end of its pipe to the end of its process."""
_LEAVING_S: Final = 0.5

_ESTIMATE: Final = struct.Struct("<2q5d?")
"""Number of the request, of the controller that is asked; changing reference or NaN, time since the last sample,
estimate."""
_OBSERVED: Final = struct.Struct(f"<2q5d?{len(Prediction._fields)}d")
"""The fields of `_ESTIMATE`, and a prediction."""
_COPY: Final = struct.Struct("<2q")
"""Number of the request, of the controller to copy."""
_CHANGE: Final = struct.Struct("<3qd")
"""Number of the request, of the controller, of the gain to change among those declared, its new value."""
_REPLY: Final = struct.Struct("<q7d")
"""Number of the request, demand."""
_NUMBER: Final = struct.Struct("<q")
"""Minus the number of the failed request; the text of the error follows."""
_MOST_BYTES: Final = PIPE_BUF
"""Largest message in a run, which a pipe takes whole."""
_NO_NUMBERS: Final = (0.0,) * 6


class IsolatedController:
    """The class of a controller that runs in another process; calling it makes a controller there.

    Raises ConfigError if the code defines no controller. `close` it in the end.
    """

    def __init__(self, name: str, source: bytes, run: Path) -> None:
        self._name = name
        self._number = 0
        self._process = _start_process(run)
        self._orders, self._answers = cast("IO[bytes]", self._process.stdin), cast("IO[bytes]", self._process.stdout)
        self._requests, self._replies = self._orders.fileno(), self._answers.fileno()
        poller = select.poll()
        poller.register(self._replies, select.POLLIN)
        self._poll = poller.poll
        try:
            declared = self._order((name, source))
        except BaseException:
            self.close()
            raise
        self.gains = tuple(Gain(*gain) for gain in declared["gains"])
        self.internals = quantities(declared["internals"])

    def __call__(self, setup: Setup, **gains: float) -> Controller:
        """Make the controller. Raises ControllerError with what its constructor raises."""
        self._kept = self._order((setup, gains))["kept"]
        return cast("Controller", _Proxy(self, 0))

    def keeps_gain(self, name: str) -> bool:
        """Whether the controller that was made can change this gain, or `reference_slip`."""
        return name in self._kept

    def answer(self, request: Callable[..., bytes], *what: object) -> list[float]:
        """Return its answer within 20 ms; without one, end its process and raise ControllerError."""
        self._number = number = self._number + 1
        try:  # noqa: SIM105  a context manager takes longer
            os.write(self._requests, request(number, *what))
        except BrokenPipeError:
            pass  # it has ended, and may have written the reason
        for _ in _LOOKS:
            if self._poll(_LOOK_MS):
                break
        else:
            raise self._give_up(f"has not answered for {len(_LOOKS) * _LOOK_MS} ms")
        reply = os.read(self._replies, _MOST_BYTES)
        if len(reply) == _REPLY.size:
            answered, *demand = _REPLY.unpack(reply)
            if answered == number:
                return demand
        raise self._failure(reply, number)

    def _failure(self, reply: bytes, number: int) -> ControllerError:
        """Return the error for a reply that is not an answer."""
        if not reply:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_DYING_S)
            code = self._process.returncode
            if code is None:
                return self._give_up("has closed the pipe of its answers")
            how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
            return self._give_up(f"has ended its process: {how}")
        if reply.startswith(_NUMBER.pack(-number)):
            return ControllerError(reply[_NUMBER.size :].decode(errors="replace"))
        return self._give_up("has written into the pipe of its answers")

    def _give_up(self, what: str) -> ControllerError:
        self._process.kill()  # it may be busy, on the loop's own CPU
        return ControllerError(f"{self._name} {what}")

    def _order(self, order: object) -> dict[str, Any]:
        """Return its answer to an order before the run; raises its ConfigError or ControllerError."""
        with suppress(BrokenPipeError):
            pickle.dump(order, self._orders)
            self._orders.flush()
        line, end = b"", time.monotonic() + LOADING_MOST_S
        while not line.endswith(b"\n"):
            if not self._poll(max(0.0, end - time.monotonic()) * 1e3):
                raise self._give_up(f"was not loaded within {LOADING_MOST_S:g} s")
            part = os.read(self._replies, _MOST_BYTES)
            if not part:
                raise self._failure(b"", 0)
            line += part
        answer: dict[str, Any] = json.loads(line)
        if "mistakes" in answer:
            raise ConfigError([ConfigIssue(*mistake) for mistake in answer["mistakes"]])
        if "error" in answer:
            raise ControllerError(answer["error"])
        return answer

    def close(self) -> None:
        """End the process."""
        with suppress(BrokenPipeError):
            self._orders.close()  # the process ends then
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVING_S)
        self._process.kill()
        self._process.wait()
        self._answers.close()


def _start_process(run: Path) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(  # noqa: S603  our own module
            # named like the other processes of the run; it does not open that file
            [sys.executable, "-P", "-m", ENTRY, "controller", str(run)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
    except OSError as error:
        why = error.strerror or error
        raise BoardError(f"the controller process cannot be started: {why}; {NO_MORE}") from error


class _Proxy:
    """One controller of the process."""

    def __init__(self, process: IsolatedController, which: int) -> None:
        self._process = process
        self._which = which
        self.reference = math.nan
        """Slip to hold now, where that changes."""

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        wheel, road, slip, valid, prediction = estimate
        known = self._which, self.reference, dt_s, wheel, road, slip, valid
        if prediction is None:
            answer = self._process.answer(_ESTIMATE.pack, *known)
        else:
            answer = self._process.answer(_OBSERVED.pack, *known, *prediction)
        brake, torque, switching, c0, c1, c2, c3 = answer
        return BrakeDemand(brake, torque, switching, (c0, c1, c2, c3))

    def keeps_gain(self, name: str, _value: float) -> bool:
        """Whether `change_gain` can change this gain."""
        return self._process.keeps_gain(name)

    def change_gain(self, name: str, value: float) -> None:
        """Change a gain, or `reference_slip`."""
        if name == REFERENCE:
            self.reference = value
        else:
            number = [gain.name for gain in self._process.gains].index(name)
            self._process.answer(_CHANGE.pack, self._which, number, value)

    def __deepcopy__(self, _memo: object) -> _Proxy:
        """Copy the controller in its process, which then keeps only these two."""
        copy = _Proxy(self._process, int(self._process.answer(_COPY.pack, self._which)[0]))
        copy.reference = self.reference
        return copy


@contextmanager
def controllers_of(job: Job, run: Path) -> Iterator[Mapping[str, type[Controller]]]:
    """Yield the controllers for the loop's process: those that ship, or a user's, which runs in its own process."""
    name = job.config.controller.name
    if name in CONTROLLERS:
        yield CONTROLLERS
        return
    isolated = IsolatedController(name, job.controller_source, run)
    try:
        yield {name: cast("type[Controller]", isolated)}
    finally:
        isolated.close()


def main(_path: str) -> int:
    """Load the controller that the parent names, make it, and answer; end when the parent does."""
    end_with_parent()
    requests, replies = os.dup(0), os.dup(1)
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123  a controller must not read or print there
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    os.register_at_fork(after_in_child=lambda: os._exit(1))  # two would answer
    code = 1
    try:
        _serve(requests, replies)
        code = 0
    except BaseException:  # noqa: BLE001  the top of a process: its end must explain itself
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # at once: Python would wait for a controller's threads, for ever


def _serve(requests: int, replies: int) -> None:
    made = _make_controller(requests, replies)
    if made is None:
        return
    controller, kept = made
    apply(controller_tuning())
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))  # without root's rights nothing here rises above the loop
    _write(replies, {"kept": kept})
    _answer(requests, replies, controller)
    for file in late_files():
        sys.stderr.write(f"inteco-abs: the controller opened {file} while it ran: the session does not keep that\n")


def _make_controller(requests: int, replies: int) -> tuple[Controller, list[str]] | None:
    """Return the requested controller, and the gains that it can change; None after an error, written as the answer."""
    with os.fdopen(requests, "rb", closefd=False) as orders:
        try:
            name, source = pickle.load(orders)  # noqa: S301  it comes from the trusted parent
            kind: Any = _load(name, source)
            _write(replies, {"gains": kind.gains, "internals": kind.internals})
            setup, gains = pickle.load(orders)  # noqa: S301
            controller: Controller = kind(setup, **gains)
            values = {REFERENCE: setup.reference_slip, **gains}
            kept = [gain for gain, value in values.items() if keeps_gain(controller, gain, value)]
            with_files(name, source)
        except EOFError:  # the parent has ended
            return None
        except ConfigError as error:
            _write(replies, {"mistakes": error.mistakes})
            return None
        except BaseException as error:  # noqa: BLE001  the top of a process, with a user's code in it
            _write(replies, {"error": describe_error(error)})
            return None
    return controller, kept


def _answer(requests: int, replies: int, controller: Controller) -> None:
    """Answer until the parent ends or the controller fails."""
    read, write, pack = os.read, os.write, _REPLY.pack
    controllers, number = {0: controller}, 0
    try:
        while request := read(requests, _MOST_BYTES):
            if len(request) == _ESTIMATE.size:
                number, which, slip_to_hold, dt_s, wheel, road, slip, valid = _ESTIMATE.unpack(request)
                answer = _demand(controllers[which], slip_to_hold, Estimate(wheel, road, slip, valid), dt_s)
            elif len(request) == _OBSERVED.size:
                number, which, slip_to_hold, dt_s, wheel, road, slip, valid, *prediction = _OBSERVED.unpack(request)
                estimate = Estimate(wheel, road, slip, valid, Prediction(*prediction))
                answer = _demand(controllers[which], slip_to_hold, estimate, dt_s)
            elif len(request) == _CHANGE.size:
                number, which, gain, value = _CHANGE.unpack(request)
                set_gain(controllers[which], controllers[which].gains[gain].name, value)
                answer = (number, *_NO_NUMBERS)
            else:
                number, which = _COPY.unpack(request)
                controllers = {which: controllers[which], number: deepcopy(controllers[which])}
                answer = (number, *_NO_NUMBERS)
            write(replies, pack(number, *answer))
    except BaseException as error:  # noqa: BLE001  as above
        os.write(replies, (_NUMBER.pack(-number) + describe_error(error).encode())[:_MOST_BYTES])


def _load(name: str, source: bytes) -> type[Controller]:
    return load_controller(name, source)[0] if FROM_FILE in name else Controllers()[name]


def _write(replies: int, answer: object) -> None:
    os.write(replies, json.dumps(answer, default=float).encode() + b"\n")


def _demand(controller: Any, slip_to_hold: float, estimate: Estimate, dt_s: float) -> tuple[float, ...]:
    if not math.isnan(slip_to_hold):  # the reference changes, and the class has one
        controller.reference = slip_to_hold
    brake, torque, switching, (c0, c1, c2, c3) = demand_of(controller, estimate, dt_s)
    # the guard judges what is not a number
    return brake if type(brake) is float else math.nan, torque, switching, c0, c1, c2, c3
