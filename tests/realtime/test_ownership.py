import os
import subprocess
import threading

import pytest

from inteco_abs.errors import BoardError, LinkError, ReadOnlyError, SessionError, UnsafeError
from inteco_abs.realtime import ownership as holder
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.ownership import holding, post_failure, run_role, stopped
from inteco_abs.signals import Reason


@pytest.fixture
def guarded(memory):
    """A memory whose guardian watches this process."""
    memory.words[Field.GUARDING_PID] = os.getpid()
    return memory


def hold_and_raise(memory, error):
    with holding(memory):
        raise error


class TestHolding:
    def test_it_waits_until_the_guardian_watches_this_very_process(self, memory, until):
        steps = []

        def hold():
            with holding(memory):
                steps.append("holds")

        memory.words[Field.GUARDING_PID] = os.getppid()
        thread = threading.Thread(target=hold)
        thread.start()
        thread.join(0.05)
        steps.append("watches")
        assert memory.words[Field.HOLDER_PID] == 0
        memory.words[Field.GUARDING_PID] = os.getpid()
        until(lambda: not thread.is_alive(), "it goes on")
        assert steps == ["watches", "holds"]

    @pytest.mark.parametrize("word", [Field.STOP, Field.GUARDIAN_STOP])
    def test_a_run_that_is_to_end_does_not_wait_for_the_guardian_and_opens_nothing(self, memory, word):
        memory.words[word] = Reason.OPERATOR_STOP
        with pytest.raises(BoardError, match="guardian does not watch"):
            hold_and_raise(memory, AssertionError("it must not come so far"))
        assert memory.words[Field.HOLDER_PID] == 0

    def test_without_a_guardian_nothing_is_opened(self, memory, monkeypatch):
        monkeypatch.setattr(holder, "PATIENCE_S", 0.02)
        with pytest.raises(BoardError, match="guardian does not watch"):
            hold_and_raise(memory, AssertionError("it must not come so far"))
        assert memory.words[Field.HOLDER_PID] == 0

    def test_the_board_is_owned_by_this_process_until_a_normal_end(self, guarded):
        with holding(guarded):
            assert guarded.words[Field.HOLDER_PID] == os.getpid()
        assert guarded.words[Field.HOLDER_PID] == 0

    @pytest.mark.parametrize(
        "error",
        [BoardError("busy"), LinkError("no answer"), ReadOnlyError("unknown"), ValueError("x"), KeyboardInterrupt()],
        ids=lambda error: type(error).__name__,
    )
    def test_after_an_error_that_left_the_board_safe_no_process_holds_it(self, guarded, error):
        with pytest.raises(type(error)) as caught:
            hold_and_raise(guarded, error)
        assert caught.value is error
        assert guarded.words[Field.HOLDER_PID] == 0

    def test_a_board_that_could_not_be_made_safe_stays_held_for_the_guardian(self, guarded):
        with pytest.raises(UnsafeError):
            hold_and_raise(guarded, UnsafeError("SAFE could not be confirmed"))
        assert guarded.words[Field.HOLDER_PID] == os.getpid()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [((), False), ((Field.STOP,), True), ((Field.GUARDIAN_STOP,), True), ((Field.GO, Field.OVER), False)],
)
def test_a_run_has_to_end_when_either_side_requests_it(memory, words, wanted):
    for word in words:
        memory.words[word] = 1
    assert stopped(memory) == wanted


def test_a_run_without_a_supervisor_is_to_end(memory):
    with subprocess.Popen(["true"]) as gone:
        gone.wait()
        memory.words[Field.SUPERVISOR_PID] = gone.pid
        assert stopped(memory)


@pytest.mark.parametrize(
    ("error", "kind", "text"),
    [
        (SessionError("the disk is full"), "SessionError", "the disk is full"),
        (UnsafeError("not confirmed"), "UnsafeError", "not confirmed"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError", "ZeroDivisionError: by zero"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_failure_is_stored_with_kind_text_and_notes(memory, error, kind, text):
    error.add_note("and then")
    post_failure(memory, Mailbox.FAILURE, error)
    assert memory.note(Mailbox.FAILURE) == {"kind": kind, "text": text, "notes": ["and then"]}


def test_a_role_acts_on_the_memory_and_the_job_at_its_path(memory, job_of):
    job_of(memory)
    acted = []
    assert run_role(str(memory.path), lambda *given: acted.append(given)) == 0
    ((found, job),) = acted
    assert (found.path, job.session_id) == (memory.path, "an-id")


def test_an_error_ends_a_role_with_its_exit_code_and_is_left_for_the_supervisor(memory, job_of):
    job_of(memory)

    def act(_memory, _job):
        raise UnsafeError("not confirmed")

    assert run_role(str(memory.path), act) == UnsafeError.exit_code != 0
    assert memory.note(Mailbox.FAILURE)["text"] == "not confirmed"


def test_an_error_of_any_length_is_left(memory):
    post_failure(memory, Mailbox.FAILURE, ValueError("x" * 100_000))
    assert memory.note(Mailbox.FAILURE)["kind"] == "ValueError"
