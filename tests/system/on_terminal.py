"""A program on a terminal of its own, as a user would have it: a pseudo terminal, whose other end is the test's."""

import fcntl
import os
import select
import struct
import subprocess
import termios
import time


class OnTerminal:
    """Started with its keyboard and its screen at a new terminal; `written` is everything that it wrote so far.

    `typed` is on the keyboard before it starts.
    """

    def __init__(self, arguments, *, columns=100, rows=30, typed="", **options):
        self._end, terminal = os.openpty()
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, 0, 0))
        self.at_first = termios.tcgetattr(terminal)
        self.written = ""
        self._terminal = terminal
        self.press(typed)
        self.process = subprocess.Popen(
            arguments,
            stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509  nothing else runs in the child
            **options,
        )  # fmt: skip

    def press(self, keys):
        os.write(self._end, keys.encode())

    def until(self, text, most_s=60.0):
        """Reads on until `text` was written."""
        end = time.monotonic() + most_s
        while text not in self.written:
            assert time.monotonic() < end, self.written
            assert self._read(0.1) or self.process.poll() is None, self.written

    def end(self, most_s=60.0):
        """Its exit code, with all read that it wrote."""
        end = time.monotonic() + most_s
        while self.process.poll() is None:
            assert time.monotonic() < end, self.written
            self._read(0.1)
        while self._read(0.0):
            pass
        return self.process.returncode

    @property
    def settings(self):
        """Settings of the terminal, as termios has them."""
        return termios.tcgetattr(self._terminal)

    @property
    def unread(self):
        """Bytes that were typed and not read: the shell would get them."""
        return struct.unpack("i", fcntl.ioctl(self._terminal, termios.FIONREAD, b"\0" * 4))[0]

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._end)
        os.close(self._terminal)

    def _read(self, most_s):
        if not select.select([self._end], [], [], most_s)[0]:
            return False
        self.written += os.read(self._end, 65536).decode(errors="replace")
        return True
