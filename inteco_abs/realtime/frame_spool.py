"""Raw frames of a run in real time: a file beside the ring carries them from the loop to the session's writer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from inteco_abs.errors import CaptureError
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Mailbox, RunMemory
from inteco_abs.wire import Capture, Record, Recording, open_capture, write_capture

if TYPE_CHECKING:
    from inteco_abs.sessions import Frames  # the loop's process must not load it


@contextmanager
def saving_frames(memory: RunMemory, job: Job, around: Recording) -> Iterator[None]:
    """On leaving, with the board closed, save the recorded frames beside the ring if the job asks for them.

    Raises CaptureError if there is no room; if another exception is on its way, adds a note to that instead.
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


def spool_frames(memory: RunMemory, frames: Frames) -> None:
    """Save the frames of a run in virtual time; without room they are lost."""
    with suppress(CaptureError), frames() as (head, records):
        write_capture(memory.frames, head._replace(records=tuple(records)))


def spooled_frames(memory: RunMemory, job: Job) -> Frames | None:
    """Return what opens the raw frames of the run in `memory`; None if the job does not ask for them."""
    if not job.frames:
        return None

    @contextmanager
    def opened() -> Iterator[tuple[Capture, Iterable[Record]]]:
        if not memory.frames.exists():
            failure = memory.note(Mailbox.FAILURE)
            raise CaptureError(failure["text"] if failure else "the loop's process ended before it had saved them")
        with open_capture(memory.frames) as parts:
            yield parts

    return opened
