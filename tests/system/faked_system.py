"""Runs verbs as on another system: `python faked_system.py SYSTEM FOLDER`; prints what each ended with, as JSON.

What Windows' Python lacks is taken away: modules, and names of modules (compared with CPython 3.12.9 for Windows). What
the standard library itself uses of it here, such as the ways to start a process, is loaded before.
"""

import contextlib
import importlib
import io
import json
import os
import platform
import re
import signal
import socket
import sys
import sysconfig
import threading

MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}
NAMES = {
    "win32": {
        "mmap": "MAP_ANON MAP_ANONYMOUS MAP_POPULATE MAP_PRIVATE MAP_SHARED PROT_READ PROT_WRITE",
        "os": (
            "CLD_EXITED O_ASYNC O_DIRECT O_DIRECTORY O_DSYNC O_NDELAY O_NOCTTY O_NOFOLLOW O_NONBLOCK O_PATH "
            "O_SYNC SCHED_FIFO SCHED_OTHER SCHED_RR SEEK_DATA SEEK_HOLE chown copy_file_range eventfd fchdir "
            "fchmod fchown fdatasync fork forkpty fstatvfs getegid geteuid getgid getgroups getloadavg "
            "getpgid getpgrp getpriority getsid getuid killpg lockf major memfd_create minor mkfifo nice "
            "openpty pidfd_open posix_fadvise posix_fallocate pread preadv pwrite pwritev readv "
            "register_at_fork sched_getaffinity sched_getscheduler sched_setaffinity sched_setscheduler "
            "sched_yield setpgid setpriority setsid splice statvfs sync sysconf tcgetpgrp tcsetpgrp "
            "ttyname uname wait wait3 wait4 waitid writev"
        ),
        "select": "PIPE_BUF POLLIN POLLOUT epoll poll",
        "signal": (
            "ITIMER_REAL SIGALRM SIGCHLD SIGCONT SIGHUP SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGTTIN "
            "SIGTTOU SIGUSR1 SIGUSR2 SIGWINCH alarm pthread_kill pthread_sigmask setitimer sigpending "
            "sigtimedwait sigwait"
        ),
        "socket": "AF_UNIX MSG_DONTWAIT SOCK_SEQPACKET SO_PEERCRED",
        "time": "CLOCK_MONOTONIC CLOCK_REALTIME clock_gettime clock_gettime_ns tzset",
    },
    "darwin": {
        "mmap": "MAP_POPULATE",
        "os": (
            "O_DIRECT O_PATH SCHED_RESET_ON_FORK copy_file_range eventfd fdatasync memfd_create pidfd_open "
            "posix_fadvise posix_fallocate sched_getaffinity sched_setaffinity sched_getscheduler "
            "sched_setscheduler splice"
        ),
        "signal": "SIGPWR SIGRTMIN SIGSTKFLT sigtimedwait sigwaitinfo",
        "socket": "SO_PEERCRED",
        "time": "CLOCK_BOOTTIME CLOCK_TAI",
    },
}
BEFORE = (
    "asyncio",
    "bokeh.plotting",
    "click",
    "multiprocessing.synchronize",
    "numpy",
    "pydantic",
    "rich.table",
    "uuid",
)
"""Load parts for this system."""
BEFORE_VERB = {"figure": "matplotlib.font_manager", "sweep": "numba"}
"""Takes long to load; the list of fonts is made at the first import, in Windows' way from its registry."""


def pretend(system):
    for name in (*BEFORE, *(name for verb, name in BEFORE_VERB.items() if f'"{verb}"' in sys.argv[3])):
        importlib.import_module(name)
    sysconfig.get_config_vars()
    platform.platform()
    if system == "win32":
        signals = {signal.SIGINT, signal.SIGILL, signal.SIGABRT, signal.SIGFPE, signal.SIGSEGV, signal.SIGTERM}
        signal.valid_signals = lambda: signals
    pair, family = socket.socketpair, socket.AF_UNIX
    socket.socketpair = lambda: pair(family)  # Windows' Python makes one of two TCP sockets
    for module, names in NAMES[system].items():
        for name in names.split():
            delattr(importlib.import_module(module), name)
    if system == "win32":
        for name in MODULES:
            sys.modules[name] = None  # an import raises ModuleNotFoundError
    sys.platform = system


def verb(*arguments):
    from inteco_abs.cli.command import main

    sys.argv = ["inteco-abs", *arguments]
    out = io.TextIOWrapper(io.BytesIO(), encoding="cp1252", newline="")
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            main()
        except SystemExit as end:
            code = end.code
        out.flush()
    return {"code": code, "text": out.buffer.getvalue().decode("cp1252")}


def mock_board_over_tcp():
    """How many bytes a list of devices has."""
    from inteco_abs.config import load_config
    from inteco_abs.mock_board_process import Mock, serve_usbip

    said, ready = [], threading.Event()

    def say(line):
        said.append(line)
        ready.set()

    arguments = Mock(load_config(), 1), "127.0.0.1:0", 900_000_001, say
    threading.Thread(target=serve_usbip, args=arguments, daemon=True).start()
    assert ready.wait(10)
    port = int(re.search(r"127\.0\.0\.1:(\d+)", said[0])[1])
    with socket.create_connection(("127.0.0.1", port), 10) as client:
        client.sendall(bytes.fromhex("0111 8005 0000 0000"))
        client.settimeout(10)
        return len(client.recv(4096))


def main():
    system, folder, verbs = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    os.chdir(folder)
    pretend(system)
    found = [verb(*arguments) for arguments in verbs]
    board = mock_board_over_tcp()
    sys.__stdout__.write(json.dumps({"verbs": found, "board": board}))


if __name__ == "__main__":
    main()
