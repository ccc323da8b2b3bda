"""A byte stream gives the same answers, or the same rejection, however it is split."""

import struct

import pytest
from drill import new_host
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.mock_board import UsbSpeed
from inteco_abs.mock_board.usbip.attachment import Attachment
from inteco_abs.mock_board.usbip.messages import MalformedError, take_command, take_request

DEVICE_ID = 0x00010002


def submit(sequence, reads, endpoint, length, flags, request):
    setup = bytes((0x80 * reads, request, 1, 0, 0, 0, length & 0xFF, 0))
    header = struct.pack(">IIIIIIiiII8s", 1, sequence, DEVICE_ID, reads, endpoint, flags, length, 0, 0, 0, setup)
    return header if reads else header + bytes(length)


def unlink(sequence, victim):
    return struct.pack(">IIIIII24x", 2, sequence, DEVICE_ID, 0, 0, victim)


numbers = st.integers(1, 8)
commands = st.builds(
    submit,
    numbers,
    st.booleans(),
    st.sampled_from([0, 2, 4, 6, 8]),
    st.integers(0, 300),
    st.sampled_from([0, 0x01, 0x40, 0xFFFFFFFF]),
    st.integers(0, 12) | st.sampled_from([0xD9, 0xDA, 0xDE, 0xDF]),
) | st.builds(unlink, numbers, numbers)
streams = st.lists(commands | st.binary(max_size=60), max_size=12).map(b"".join)


def answers(pieces):
    """Return the peer's received bytes, and whether it is disconnected."""
    sent = []
    host = new_host(UsbSpeed.FULL, drill=False)
    attachment = Attachment(host, DEVICE_ID, sent.append)
    stream = bytearray()
    try:
        for piece in pieces:
            stream += piece
            while (command := take_command(stream)) is not None:
                attachment.handle(command)
    except MalformedError:
        return b"".join(sent), True
    finally:
        attachment.end()
        assert not any(host._queues.values())
    return b"".join(sent), False


@pytest.mark.untraced
@given(streams, st.integers(1, 100))
def test_commands_in_pieces(data, size):
    whole = answers([data])
    assert answers([data[at : at + size] for at in range(0, len(data), size)]) == whole


drafts = st.lists(
    st.tuples(st.booleans(), st.sampled_from([0, 2, 4, 8]), st.integers(0, 300)) | st.integers(1, 12), max_size=12
)


@given(drafts)
def test_each_transfer_ends_once_and_each_unlink_says_how(draft):
    """A number is an unlink of the message with that number."""
    sent = []
    host = new_host(UsbSpeed.FULL, drill=False)
    host.device.configuration = 1
    attachment = Attachment(host, DEVICE_ID, sent.append)
    for sequence, what in enumerate(draft, 1):
        message = unlink(sequence, what) if isinstance(what, int) else submit(sequence, *what, 0, 6)
        attachment.handle(take_command(bytearray(message)))
    replies = [struct.unpack_from(">II12xi", message) for message in sent]
    answered = [sequence for command, sequence, _ in replies if command == 3]
    unlinked = {sequence: status for command, sequence, status in replies if command == 4}
    assert len(answered) == len(set(answered))
    assert list(unlinked) == [sequence for sequence, what in enumerate(draft, 1) if isinstance(what, int)]
    taken_back = [draft[sequence - 1] for sequence, status in unlinked.items() if status]
    assert len(taken_back) == len(set(taken_back))
    assert not set(taken_back) & set(answered)
    waiting = set(attachment._in_flight)
    submitted = {sequence for sequence, what in enumerate(draft, 1) if not isinstance(what, int)}
    assert set(answered) | set(taken_back) | waiting == submitted


@given(st.binary(max_size=100), st.integers(1, 10))
def test_requests_in_pieces(data, size):
    def outcome(pieces):
        stream = bytearray()
        try:
            for piece in pieces:
                stream += piece
                if (request := take_request(stream)) is not None:
                    return request
        except MalformedError:
            return "malformed"
        return None

    assert outcome([data]) == outcome([data[at : at + size] for at in range(0, len(data), size)])
