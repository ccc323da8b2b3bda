import pytest
from hypothesis import given
from hypothesis import strategies as st
from usb_monitor import Usbmon, UsbPcap, pcap

from inteco_abs.errors import CaptureError
from inteco_abs.wire.byte_stream import MessageCutter
from inteco_abs.wire.capture import Record, RecordKind
from inteco_abs.wire.pcap import import_pcap

DUMMY, REQUEST = b"\x80", b"\x82"
SEND = b"\x81" + bytes(range(100)) + bytes(49)
ANSWER = b"\x11\x01" + bytes(range(100, 248))
STATUS = b"\x01\x60"


def ftdi(payload):
    """As the chip packs it: two bytes of status at the start of every 64."""
    pieces = [payload[at : at + 62] for at in range(0, len(payload), 62)] or [b""]
    return b"".join(STATUS + piece for piece in pieces)


def cut(data, sizes):
    pieces, at = [], 0
    for size in sizes:
        pieces.append(data[at : at + size])
        at += size
    return [piece for piece in (*pieces, data[at:]) if piece]


def out(data, t_s=0.0):
    return Record(t_s, RecordKind.OUT, 2, data)


def into(payload, t_s=0.0):
    return Record(t_s, RecordKind.IN, 0x81, ftdi(payload))


def messages(*transfers):
    return [(record.kind, record.data or record.text) for record in MessageCutter().messages(transfers)]


@pytest.mark.parametrize("monitor", [Usbmon(), UsbPcap()], ids=["usbmon", "usbpcap"])
@pytest.mark.parametrize("board", ["usb1-111", "usb1-112"])
def test_messages_of_a_first_generation_board_are_put_together(tmp_path, monitor, board):
    packets = [
        *monitor.out(0x02, DUMMY),
        *monitor.into(0x81, STATUS),
        *monitor.out(0x02, SEND),
        *monitor.out(0x02, REQUEST),
        *monitor.into(0x81, ftdi(ANSWER[:70])),
        *monitor.into(0x81, STATUS),
        *monitor.into(0x81, ftdi(ANSWER[70:])),
    ]
    path = tmp_path / "vendor.pcap"
    path.write_bytes(pcap(packets, monitor.link_type))
    capture = import_pcap(path, board=board)
    assert [(record.kind, record.data) for record in capture.records] == [
        (RecordKind.OUT, DUMMY),
        (RecordKind.OUT, SEND),
        (RecordKind.OUT, REQUEST),
        (RecordKind.IN, ANSWER),
    ]
    assert capture.board == board


def test_a_second_generation_board_is_not_mistaken_for_one_of_the_first(tmp_path):
    monitor = Usbmon()
    path = tmp_path / "vendor.pcap"
    path.write_bytes(pcap(monitor.out(0x02, b"\x0f\x8f" + bytes(502)), monitor.link_type))
    with pytest.raises(CaptureError, match="no device has this board's traffic"):
        import_pcap(path, board="usb1-111")


@given(
    st.lists(st.sampled_from([DUMMY, SEND, REQUEST]), min_size=1, max_size=6), st.lists(st.integers(1, 60), max_size=20)
)
def test_messages_to_the_board_survive_any_cutting(sent, sizes):
    pieces = cut(b"".join(sent), sizes)
    assert messages(*map(out, pieces)) == [(RecordKind.OUT, message) for message in sent]


@given(st.binary(min_size=150, max_size=150), st.lists(st.integers(1, 70), max_size=10))
def test_an_answer_survives_any_cutting(answer, sizes):
    found = messages(out(REQUEST), *map(into, cut(answer, sizes)))
    assert found == [(RecordKind.OUT, REQUEST), (RecordKind.IN, answer)]


def test_send_and_read_is_one_message_that_is_answered():
    both = b"\x83" + SEND[1:]
    assert messages(out(both), into(ANSWER)) == [(RecordKind.OUT, both), (RecordKind.IN, ANSWER)]


def test_a_message_has_the_time_at_which_it_was_whole():
    found = MessageCutter().messages([out(SEND[:10], 1.0), out(SEND[10:], 2.0)])
    assert [record.t_s for record in found] == [2.0]


def test_what_an_answer_has_left_is_dropped_at_the_next_request():
    found = messages(out(REQUEST), into(ANSWER[:40]), out(REQUEST), into(ANSWER))
    assert found == [
        (RecordKind.OUT, REQUEST),
        (RecordKind.WARNING, "40 bytes from the board before a request are left out"),
        (RecordKind.OUT, REQUEST),
        (RecordKind.IN, ANSWER),
    ]


def test_bytes_without_a_request_are_not_an_answer():
    assert messages(out(REQUEST), into(ANSWER), into(ANSWER)) == [
        (RecordKind.OUT, REQUEST),
        (RecordKind.IN, ANSWER),
        (RecordKind.WARNING, "150 bytes from the board at the end of the capture are left out"),
    ]


def test_bytes_before_a_command_are_left_out():
    assert messages(out(b"\x01\x02\x03" + REQUEST)) == [
        (RecordKind.WARNING, "3 bytes to the board before a command are left out"),
        (RecordKind.OUT, REQUEST),
    ]


def test_a_message_that_another_one_interrupts_is_left_out():
    assert messages(out(SEND[:50] + REQUEST)) == [
        (RecordKind.WARNING, "50 bytes of a message to the board that another one interrupts are left out"),
        (RecordKind.OUT, REQUEST),
    ]


def test_failures_and_control_transfers_stay_in_their_place():
    reset = Record(0.0, RecordKind.CONTROL, 0, setup=bytes.fromhex("4000000000000000"))
    failure = Record(0.0, RecordKind.ERROR, 0x81, text="transfer failed", of="in")
    found = MessageCutter().messages([reset, out(REQUEST), failure, into(ANSWER)])
    assert [record.kind for record in found] == [RecordKind.CONTROL, RecordKind.OUT, RecordKind.ERROR, RecordKind.IN]


def test_an_unfinished_end_is_warned_of():
    assert messages(out(REQUEST), into(ANSWER[:9]), out(SEND[:50])) == [
        (RecordKind.OUT, REQUEST),
        (RecordKind.WARNING, "50 bytes to the board at the end of the capture are left out"),
        (RecordKind.WARNING, "9 bytes from the board at the end of the capture are left out"),
    ]


@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=200)), max_size=20))
def test_any_bytes_give_whole_messages_or_warnings(transfers):
    records = [Record(0.0, RecordKind.IN if inward else RecordKind.OUT, 2, data) for inward, data in transfers]
    for record in MessageCutter().messages(records):
        if record.kind is RecordKind.OUT:
            assert len(record.data) == (150 if record.data[0] in b"\x81\x83" else 1)
        elif record.kind is RecordKind.IN:
            assert len(record.data) == 150
