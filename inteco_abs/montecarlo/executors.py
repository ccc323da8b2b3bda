"""Where the units of a sweep run: in this process, in processes of this computer, or on an executor of a package."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import active_children, get_context, parent_process
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final, cast

from inteco_abs.entry_points import Registry, attribute, foreign_code
from inteco_abs.errors import ConfigError, near_match
from inteco_abs.posix import resource

_OPTION: Final = "--executor"
_LOOK_S: Final = 0.1
_FILES_EACH: Final = 10
"""Files that a pool of one process opens, at most."""
ExecutorFactory = Callable[..., Executor]


class InThisProcess(Executor):
    """Runs what it gets at once."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **keywords: Any) -> Future[Any]:
        """Run it; the future is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments, **keywords))
        except Exception as error:  # noqa: BLE001  as an executor, it hands it on
            future.set_exception(error)
        return future


class LocalProcesses(Executor):
    """Pool of which a killed process costs nothing but the task that it had: a new process takes its place.

    When it is left by an exception, its processes are terminated.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        _allow_files(_FILES_EACH * count)
        self._threads = ThreadPoolExecutor(count)
        self._idle = SimpleQueue[ProcessPoolExecutor]()
        for _ in range(count):
            self._idle.put(_one_process())

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **keywords: Any) -> Future[Any]:
        """Run it in an idle process; the future raises BrokenExecutor if the process dies."""
        return self._threads.submit(self._call, function, *arguments, **keywords)

    def _call(self, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        pool = self._idle.get()
        try:
            return pool.submit(function, *arguments, **keywords).result()
        except BrokenExecutor:
            pool.shutdown()
            pool = _one_process()
            raise
        finally:
            self._idle.put(pool)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when they have done what they have."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for _ in range(self._count if wait else 0):
            self._idle.get().shutdown()

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        ending = Thread(target=self.shutdown, kwargs={"cancel_futures": True})
        ending.start()
        while ending.is_alive():
            for process in active_children() if kind else ():
                process.terminate()
            ending.join(_LOOK_S)


def _allow_files(count: int) -> None:
    """Let this process open so many files more, as far as the system does; the usual 1024 are few for 128 cores."""
    if sys.platform != "win32":
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = soft + count
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted if hard < 0 else min(wanted, hard), hard))


def _one_process() -> ProcessPoolExecutor:
    # spawned: a forked copy of a process with threads, as the progress bar's, may hang
    return ProcessPoolExecutor(1, get_context("spawn"), _begin_worker)


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, send prints to stderr, and end when the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stdout = sys.stderr
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def named_executor(text: str) -> Executor:
    """The executor NAME or NAME=ARGUMENT, where NAME is `dask`, a package's entry point, or `module:callable`.

    Raises ConfigError if there is none, and AbsError if it cannot be had.
    """
    name, _, argument = text.partition("=")
    shipped = {"dask": "inteco_abs.montecarlo.executors:dask_executor"}
    registry = Registry("an executor", "inteco_abs.executors", _OPTION, shipped, _require_callable)
    if ":" in name:
        with foreign_code(_OPTION, name):
            factory = attribute(name)
    elif name in registry:
        factory = registry[name]
    else:
        raise ConfigError.of(_OPTION, f"no executor {name!r}{near_match(name, registry)}")
    with foreign_code(_OPTION, text):
        made = _require_callable(_OPTION, factory, name)(*([argument] if argument else []))
    if not isinstance(made, Executor):
        raise ConfigError.of(_OPTION, f"{text}: made a {type(made).__name__}, not a concurrent.futures.Executor")
    return made


def _require_callable(path: str, part: object, what: str) -> ExecutorFactory:
    if not callable(part):
        raise ConfigError.of(path, f"{what}: must be callable, and return a concurrent.futures.Executor")
    return part


def dask_executor(address: str) -> Executor:
    """Executor of the Dask scheduler at an address such as tcp://host:8786."""
    try:
        connect = attribute("distributed:Client")
    except ImportError as error:
        raise ImportError("needs Dask: pip install 'inteco-abs[cluster]'") from error
    client = connect(address, set_as_default=False)
    executor = client.get_executor(pure=False)  # else a unit that failed would not be tried again
    executor._max_workers = max(1, sum(client.nthreads().values()))  # noqa: SLF001  as those of the standard library
    return cast(Executor, executor)


def count_workers(executor: Executor) -> int:
    """How many tasks an executor runs at once, as far as it says so; otherwise the number of cores here."""
    found = getattr(executor, "_max_workers", None)
    return found if isinstance(found, int) and found > 0 else cores()


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
