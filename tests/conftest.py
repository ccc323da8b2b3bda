import gc
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader

if sys.platform != "win32":
    import fcntl

from pathlib import Path
from typing import NamedTuple

import pytest
from chromium import chromium
from hypothesis import HealthCheck, Phase, settings
from xdist.scheduler import LoadGroupScheduling

from inteco_abs.warm_up import asked_for

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # every core has a worker already, and idle threads of numpy spin

settings.register_profile("default", deadline=None, max_examples=10)
settings.register_profile("long", deadline=None, max_examples=300, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile(  # a failure is all that tools/mutate asks for, and the same one each time
    "mutation", deadline=None, database=None, derandomize=True, phases=[Phase.explicit, Phase.generate]
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))

if sys.platform != "win32":  # under nohup it is ignored, and a server that a test starts would not end by it
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class FilesTogether(LoadGroupScheduling):
    """A file's tests stay on one worker, which makes their fixtures once; those of an xdist_group are with the group.

    The scheduler counts all units of work after each test: ten thousand of single tests would take it half a minute.
    """

    def _split_scope(self, nodeid):
        return super()._split_scope(nodeid).partition("::")[0]


@pytest.hookimpl(optionalhook=True)  # without workers
def pytest_xdist_make_scheduler(config, log):
    return FilesTogether(config, log)


_final = list[str]()
PATIENCE_S = 30.0
"""For what takes milliseconds on an idle machine."""


def pytest_runtest_logreport(report):
    """Note what no busy computer causes: an error of a teardown, or a test that ended its process (phase "???")."""
    if report.failed and report.when not in {"setup", "call"}:
        _final.append(report.nodeid)


def pytest_sessionfinish(session):
    """Keep it for tools/checks.py, which does not run these again."""
    if hasattr(session.config, "cache") and not hasattr(session.config, "workerinput"):
        session.config.cache.set("check/final", _final)


@pytest.fixture(autouse=True)
def cold():
    """Let each test begin as a program does, which has run no tick that counts towards machine code."""
    asked_for.clear()


class Verb(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture
def verb(monkeypatch, capsys):
    """Runs the command in this process: exit code, and what it wrote."""
    from inteco_abs.cli import main

    def run(*arguments) -> Verb:
        monkeypatch.setattr(sys, "argv", ["inteco-abs", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        done = Verb(end.value.code or 0, *capsys.readouterr())
        assert "Traceback" not in done.err
        return done

    return run


def pytest_configure():
    """Let tests send Ctrl-C to what they start, also where the tests run in a shell's background, which ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGQUIT"):  # the decision path is tested on Windows, too
        signal.signal(signal.SIGQUIT, signal.SIG_DFL)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect in one worker after the other: the first compiles what all import.

    The garbage collector does not look at eleven thousand tests again each time, now or later.
    """
    gc.disable()
    with Path(__file__).open(encoding="utf-8") as turn:
        if sys.platform != "win32":
            fcntl.flock(turn, fcntl.LOCK_EX)
        collected = yield
    gc.freeze()
    gc.enable()
    return collected


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Take the tracer away from tests marked `untraced`, and from the processes that they start.

    Coverage's setting `omit` would not help: on Python 3.11 a tracer slows every instruction down to a third, also
    where it does not look.
    """
    if item.get_closest_marker("untraced") is None:
        return (yield)
    tracer = sys.gettrace()
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith("COV")]:
            patch.delenv(name)
        sys.settrace(None)
        try:
            return (yield)
        finally:
            sys.settrace(tracer)


@pytest.fixture(scope="session")
def tool():
    """Imports a program of tools/, which has no suffix, by its name."""

    def load(name: str):
        loader = SourceFileLoader(name, str(Path(__file__).parents[1] / "tools" / name))
        module = module_from_spec(spec_from_loader(name, loader))
        sys.modules[name] = module
        loader.exec_module(module)
        return module

    return load


@pytest.fixture
def until():
    """Waits for a condition, and fails if it does not come true."""

    def wait(condition: Callable[[], object], what: str = "") -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"it never came to that: {what}"
            time.sleep(0.001)

    return wait


@pytest.fixture(scope="session")
def chromium_driver(tmp_path_factory):
    """The browser of all tests that look at pages: starting one takes a second."""
    with chromium(tmp_path_factory.mktemp("browser")) as driver:
        yield driver


@pytest.fixture
def without_privileges():
    """What a command is run by to have no more rights than any user."""
    if os.geteuid() != 0:
        return ()
    if shutil.which("setpriv") is None:
        pytest.fail("setpriv is needed to give up the rights of root: install util-linux")
    return ("setpriv", "--inh-caps=-all", "--bounding-set=-all")


def pytest_terminal_summary(terminalreporter):
    """Print what tests have recorded as `figures`, also when all tests pass."""
    figures = [
        text
        for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed")
        for name, text in report.user_properties
        if name == "figures" and report.when == "call"
    ]
    if figures:
        terminalreporter.section("figures of the tests")
        for text in figures:
            terminalreporter.write_line(text + "\n")
