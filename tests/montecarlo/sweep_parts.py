"""What tests of sweeps hand to workers: functions that fail, and executors."""

import os
import signal
from concurrent.futures import Executor, Future, ThreadPoolExecutor


class Failing(Executor):
    """Runs what it gets at once, but for the first `times` of each unit that `hits` is true for."""

    def __init__(self, hits, times):
        self._hits, self._left = hits, times
        self.seen = {}

    def submit(self, function, /, *arguments):
        unit = arguments[-1]
        self.seen[unit] = self.seen.get(unit, 0) + 1
        future = Future()
        if self._hits(unit) and self.seen[unit] <= self._left:
            future.set_exception(MemoryError("no room"))
        else:
            future.set_result(function(*arguments))
        return future


def two_threads():
    return ThreadPoolExecutor(2)


def some_threads(count):
    return ThreadPoolExecutor(int(count))


def killed_once(mark):
    """End this process as the kernel does when memory is short; the next time do nothing."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "survived"


def not_an_executor():
    return 1
