"""A board in the hands of a screen, in virtual time: the real board, guard and shared memory, the mock device."""

from inteco_abs.boards import InProcessLink, Link, board_behind
from inteco_abs.config import load_config
from inteco_abs.errors import LinkError
from inteco_abs.mock_board import Device, front_end_of
from inteco_abs.realtime import StopFlag, VirtualClock
from inteco_abs.realtime.processes.manual import RATE_HZ, DriveLoop, ManualClient, WatchLoop

AS_ON_A_REAL_BOARD = ("guard.missed_in_a_row=4", "guard.bucket_limit=30", "guard.brake_limit=0.7")


class WatchedLink(Link):
    """Keeps what is written; answers nothing while `dead`."""

    def __init__(self, inner):
        self.written = []
        self.dead = False
        self._inner = inner

    def write(self, data):
        self.written.append(bytes(data))
        self._inner.write(data)

    def read(self, length):
        answer = self._inner.read(length)
        if self.dead:
            raise LinkError("no answer")
        return answer

    def close(self):
        self._inner.close()


class Bench:
    """A board in the hands of a screen, beat by beat."""

    def __init__(self, memory, *settings, profile="sim_usb2"):
        rate = f"loop.rate_hz={RATE_HZ}"
        self.config = load_config(settings=[rate, *AS_ON_A_REAL_BOARD, *settings], profile=profile)
        self.clock = VirtualClock(self.config.period_ns)
        self._beats = iter(self.clock)
        next(self._beats)
        self.device = Device(self.config, self.clock.now_ns, 3)
        self._front_end = front_end_of(self.device)
        self.take(memory)

    def take(self, memory):
        """Prepare to open the board, for the first time or again: the rig keeps its state."""
        self.link = WatchedLink(InProcessLink(self._front_end))
        self.board = board_behind(self.link, self.config, self.clock.now_ns)
        self.stop = StopFlag()
        self.memory = memory
        self.side = ManualClient(memory)
        self.hand = None

    def __enter__(self):
        self.board.__enter__()
        kind = WatchLoop if self.config.board.read_only else DriveLoop
        self.hand = kind(self.board, self.config, self.memory, self.stop)
        return self

    def __exit__(self, *error):
        self.board.__exit__(*error)

    def beat(self):
        next(self._beats)
        return self.hand.beat()

    def beats(self, seconds, requested=None):
        """Duties at the motors after each beat, with the key held for `requested`."""
        seen = []
        for _ in range(round(seconds * RATE_HZ)):
            if requested is not None:
                self.side.request.keep_on(requested, self.clock.now_ns())
            assert self.beat()
            seen.append(self.device.duties)
        return seen
