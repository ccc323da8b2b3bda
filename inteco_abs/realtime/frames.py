"""Raw frames of a run in real time: a file beside the ring brings them from the loop to whoever makes the session."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from inteco_abs.errors import CaptureError
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Mailbox, RunMemory
from inteco_abs.wire import Capture, Record, Recording, opened_capture, write_capture

if TYPE_CHECKING:
    from inteco_abs.sessions import Frames  # which the loop's process never needs, nor what it loads


@contextmanager
def leaving_frames(memory: RunMemory, job: Job, around: Recording) -> Iterator[None]:
    """In the end, with the board let go of, leave beside the ring what was recorded, if the job wants that.

    Raises CaptureError if there is no room; where something else was wrong already, as a note of that.
    """
    try:
        yield
    except BaseException as error:
        try:
            _leave(memory, job, around)
        except CaptureError as second:
            error.add_note(str(second))
        raise
    _leave(memory, job, around)


def _leave(memory: RunMemory, job: Job, around: Recording) -> None:
    capture = around.capture() if job.frames else None
    if capture is not None:
        write_capture(memory.frames, capture)


def stow_frames(memory: RunMemory, frames: Frames) -> None:
    """Leave the frames of a run that another process than a loop's has recorded; without room, there will be none."""
    with suppress(CaptureError), frames() as (head, records):
        write_capture(memory.frames, head._replace(records=tuple(records)))


def frames_of(memory: RunMemory, job: Job) -> Frames | None:
    """The raw frames of the run in `memory`; None if nobody asked for them."""
    if not job.frames:
        return None

    @contextmanager
    def opened() -> Iterator[tuple[Capture, Iterable[Record]]]:
        if not memory.frames.exists():
            failure = memory.note(Mailbox.FAILURE)
            raise CaptureError(failure["text"] if failure else "the loop's process ended before it had saved them")
        with opened_capture(memory.frames) as parts:
            yield parts

    return opened
