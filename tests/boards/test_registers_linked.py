import pytest

from firmware_protocol.register_messages import decode_request, encode_answer
from firmware_protocol.registers import Write
from inteco_abs.boards import Link, LinkedRegisters
from inteco_abs.errors import LinkError


class ScriptedLink(Link):
    """Answers each request with `answer`, which receives the request's number."""

    def __init__(self):
        self.requests = []
        self.answers = []
        self.answer = lambda number: [encode_answer(number, [7])]

    def write(self, data):
        number, steps = decode_request(data)
        self.requests.append(steps)
        self.answers += self.answer(number)

    def read(self, length):
        if not self.answers:
            raise LinkError("no answer in time")
        return self.answers.pop(0)[:length]

    def close(self):
        self.requests.append("closed")


@pytest.fixture
def link():
    return ScriptedLink()


@pytest.fixture
def registers(link):
    return LinkedRegisters(link)


def test_a_read_is_one_request_and_its_answer(link, registers):
    assert registers.read(0x6C) == 7
    assert link.requests == [[0x6C]]


def test_a_write_waits_for_no_answer(link, registers):
    link.answer = lambda _number: []
    registers.write(0x6C, 0xFFFFFFFF)
    assert link.requests == [[Write(0x6C, 0xFFFFFFFF)]]


def test_a_run_is_one_message_in_the_order_given(link, registers):
    link.answer = lambda number: [encode_answer(number, [1, 2])]
    steps = [Write(0x60, 1), 0x6C, Write(0x60, 0), 0x6C]
    assert list(registers.run(steps)) == [1, 2]
    assert link.requests == [steps]


def test_answers_to_older_requests_are_dropped(link, registers):
    link.answer = lambda number: [encode_answer((number - 1) % 2**32, [5]), encode_answer(number, [6])]
    assert registers.read(0) == 6


def test_an_answer_that_came_too_late_is_not_mistaken_for_the_next_one(link, registers):
    late = []

    def hold_back(number):
        late.append(encode_answer(number, [number]))
        return []

    link.answer = hold_back
    with pytest.raises(LinkError, match="in time"):
        registers.read(0x88)
    link.answer = lambda number: [*late, encode_answer(number, [8])]
    assert registers.read(0x88) == 8


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (lambda _number: b"", "0 bytes"),
        (lambda number: encode_answer(number, [1])[:-1], "7 bytes"),
        (lambda number: encode_answer(number, []), "0 values, must be 1"),
    ],
    ids=["empty", "cut", "without values"],
)
def test_an_invalid_answer_is_an_error(link, registers, answer, text):
    link.answer = lambda number: [answer(number)]
    with pytest.raises(LinkError, match=text):
        registers.read(0)


def test_a_board_that_answers_only_other_requests_is_not_waited_for_for_ever(link, registers):
    link.answer = lambda number: [encode_answer(number ^ 1, [0])] * 1000
    with pytest.raises(LinkError, match="another program"):
        registers.read(0)


def test_two_hosts_number_their_requests_differently(link):
    def numbers():
        seen = []
        link.answer = lambda number: [seen.append(number), encode_answer(number, [0])][1:]
        LinkedRegisters(link).read(0)
        return tuple(seen)

    assert len({numbers() for _ in range(20)}) > 1


def test_closing_hangs_up(link, registers):
    registers.close()
    assert link.requests == ["closed"]
