import pytest

from inteco_abs.boards import InProcessLink, check_address, schemes
from inteco_abs.errors import ConfigError, LinkError


class Echo:
    """A device that answers every message with itself."""

    def __init__(self):
        self.messages = []

    def bulk_out(self, data):
        self.messages.append(bytes(data))

    def bulk_in(self, length):
        return self.messages.pop(0)[:length] if self.messages else b""


@pytest.fixture
def link():
    return InProcessLink(Echo())


def test_messages_keep_their_boundaries_and_their_order(link):
    for message in (b"one", b"two", b"three"):
        link.write(message)
    assert [link.read(10) for _ in range(3)] == [b"one", b"two", b"three"]


def test_a_read_returns_at_most_the_requested_bytes(link):
    link.write(b"three")
    assert link.read(2) == b"th"


def test_a_message_may_be_reused_by_its_writer(link):
    message = bytearray(b"one")
    link.write(message)
    message[:] = b"two"
    assert link.read(10) == b"one"


def test_no_answer_is_a_link_error(link):
    with pytest.raises(LinkError, match="did not answer"):
        link.read(504)


def test_a_closed_link_carries_nothing_and_may_be_closed_again(link):
    link.close()
    link.close()
    with pytest.raises(LinkError, match="closed"):
        link.write(b"one")
    with pytest.raises(LinkError, match="closed"):
        link.read(10)


def test_unread_answers_are_dropped(link):
    for message in (b"one", b"two"):
        link.write(message)
    link.discard(10)
    link.write(b"three")
    assert link.read(10) == b"three"


def test_dropping_answers_comes_to_an_end_when_there_are_always_more():
    class Chatterbox(Echo):
        def bulk_in(self, length):
            self.messages.append(b"read")
            assert len(self.messages) <= 100
            return bytes(length)

    device = Chatterbox()
    InProcessLink(device).discard(504)
    assert len(device.messages) == 32


def test_dropping_answers_of_a_closed_link_raises_nothing(link):
    link.close()
    link.discard(10)


def test_closing_writes_nothing():
    device = Echo()
    InProcessLink(device).close()
    assert not device.messages


@pytest.mark.parametrize("scheme", schemes())
def test_every_scheme_is_an_address(scheme):
    check_address(f"{scheme}:")


@pytest.mark.parametrize("address", ["", "sim", ":", "usb9:", "SIM:", "sim:extra", "sim:/", "/dev/ttyUSB0"])
def test_anything_else_is_refused_with_the_address_and_the_option_named(address):
    with pytest.raises(ConfigError) as refusal:
        check_address(address)
    (mistake,) = refusal.value.mistakes
    assert mistake.path == "--board"
    assert repr(address) in mistake.problem
