"""The host's side of the open logic, and what a test does to the board."""

from firmware_protocol import open_board
from firmware_protocol.open_board import ARM, CHALLENGE_MASK, COMMAND, CONFIGURE, DISARM, QUERY, Receiver


def decoded(data):
    """Names and fields of the frames in a stream without damage."""
    receiver = Receiver(from_host=False)
    frames = [open_board.decode(frame) for frame in receiver.feed(data)]
    assert not receiver.bad_frames
    assert not receiver.unfinished
    assert sum(message.table.size for message, _ in frames) == len(data)
    return [(message.name, values) for message, values in frames]


class OpenHost:
    """A host that speaks the open logic to a `HostBoard`."""

    def __init__(self, board):
        self.board = board

    def asked(self, message, sequence=7, **values):
        """Name and fields of the only answer."""
        (answer,) = decoded(self.board.asked(message.encode(values, sequence=sequence)))
        assert answer[1]["sequence"] == sequence
        return answer

    def status(self):
        """The board's state."""
        name, values = self.asked(QUERY)
        assert name == "STATUS"
        return values

    def configure(self, watchdog_ms=10, tick_hz=0, stop_pins=0, pwm_mode=1, pwm_prescaler=2):
        """Answer to CONFIGURE."""
        values = {"watchdog_ms": watchdog_ms, "tick_hz": tick_hz, "stop_pins": stop_pins}
        return self.asked(CONFIGURE, **values, pwm_mode=pwm_mode, pwm_prescaler=pwm_prescaler)

    def arm(self):
        """Answer to ARM with the right answer to the challenge."""
        return self.asked(ARM, answer=self.status()["challenge"] ^ CHALLENGE_MASK)

    def armed(self, **configuration):
        """Configure and arm."""
        assert self.configure(**configuration)[0] == "STATUS"
        assert self.arm()[1]["state"] == open_board.State.ARMED
        return self

    def command(self, width0, width1, sequence=7):
        """Send a command without looking for its answer."""
        self.board.write(COMMAND.encode({"width0": width0, "width1": width1}, sequence=sequence))

    def commanded(self, width0, width1, sequence=7):
        """Fields of the REPORT that answers at once."""
        name, values = self.asked(COMMAND, sequence, width0=width0, width1=width1)
        assert name == "REPORT"
        return values

    def disarm(self):
        """Answer to DISARM."""
        return self.asked(DISARM)

    def reports(self, duration_us):
        """REPORTs while time passes."""
        self.board.advance(duration_us)
        frames = decoded(self.board.read())
        assert {name for name, _ in frames} <= {"REPORT"}
        return [values for _, values in frames]
