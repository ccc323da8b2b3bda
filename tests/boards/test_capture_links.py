import pytest

from firmware_protocol import rtdac_usb
from firmware_protocol.rtdac_usb2 import FRAME_BYTES, READ_REQUEST, encode_read, encode_send
from inteco_abs.boards import InProcessLink, Link, board_behind
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.family import protocol_name
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, CaptureError, ConfigError, LinkError, UnsafeError
from inteco_abs.signals import BoardFlags, Command
from inteco_abs.wire.capture import Capture, Record, RecordKind, read_capture
from inteco_abs.wire.playback import CaptureLink
from inteco_abs.wire.recording import RecordingLink, record_wire

NUMBERING = "pwm7_prescaler"


class EchoBoard:
    """A first-generation board that echoes its settings, and whose wheels turn by a few counts a tick."""

    def __init__(self, wiring):
        self.logic = rtdac_usb.LOGICS[wiring.logic_version]
        self.name = wiring.application_names[0]
        self.settings = {}
        self.ticks = 0
        self.answers = []

    def bulk_out(self, data):
        if bytes(data) == rtdac_usb.READ_REQUEST:
            self.ticks += 1
            header = {"application_name": self.name}
            counts = {f"encoder{i}_count": 1000 * i + (3 + i) * self.ticks for i in range(self.logic.encoder_channels)}
            echo = {name: value for name, value in self.settings.items() if name in self.logic.read.fields}
            self.answers.append(self.logic.read.encode({**echo, **header, **counts}))
        else:
            self.settings = self.logic.send.decode(data)

    def bulk_in(self, length):
        return self.answers.pop(0)[:length] if self.answers else b""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "x.jsonl"


@pytest.fixture
def bench(new_usb2_bench):
    return new_usb2_bench("board.numbering_pwm=7")


@pytest.fixture
def recorded(bench, path):
    """A whole visit to the board, with its samples and its capture. `trouble` are the exchanges that fail."""

    def visit(commands, trouble=None):
        start_ns = bench.clock.time_ns
        link = RecordingLink(bench.link, path, now_ns=bench.clock.now_ns, board="usb2")
        samples = drive(bench, link, commands, trouble or {})
        link.save()
        bench.clock.time_ns = start_ns
        return samples, read_capture(path)

    return visit


def drive(bench, link, commands, trouble=()):
    with RtdacUsb2(link, bench.config.board, bench.clock.now_ns, bench.config.period_ns) as board:
        samples = []
        for number, command in enumerate(commands):
            if number in trouble:
                bench.fail_next(trouble[number])
            bench.clock.advance(bench.config.period_ns)
            samples.append(board.exchange(command))
    return samples


RAMP = [Command(min(number / 30, 1.0), 0.0) for number in range(40)] + [Command(0.0, 0.4)] * 10


def test_a_visit_replays_with_no_difference_and_the_same_samples(bench, recorded):
    samples, capture = recorded(RAMP)
    link = CaptureLink(capture, strict=True)
    assert drive(bench, link, RAMP) == samples
    assert samples[-1].road_count > 0
    assert (link.differences, link.left) == ([], 0)


def test_a_visit_with_failures_replays_with_the_same_failures(bench, recorded, ways_to_fail):
    trouble = {3 * number + 2: way for number, way in enumerate(ways_to_fail)}
    samples, capture = recorded(RAMP, trouble)
    assert sum(sample.board_flags == BoardFlags.STALE for sample in samples) == len(trouble)
    link = CaptureLink(capture, strict=True)
    assert drive(bench, link, RAMP) == samples
    assert (link.differences, link.left) == ([], 0)


def test_a_visit_to_a_first_generation_board_replays_with_no_difference(path):
    config = load_config(settings=["profile=sim_usb"])
    device = EchoBoard(config.board)
    board = protocol_name(config.board)

    def visit(link):
        with board_behind(link, config, lambda: 0) as entered:
            return [entered.exchange(command) for command in RAMP]

    link = RecordingLink(InProcessLink(device), path, board=board, now_ns=lambda: 0)
    samples = visit(link)
    link.save()
    link = CaptureLink(read_capture(path), strict=True)
    assert visit(link) == samples
    assert samples[-1].wheel_count != samples[-1].road_count
    assert (link.differences, link.left) == ([], 0)


def test_a_profile_names_its_boards_protocol():
    assert protocol_name(load_config(settings=["profile=sim_usb2"]).board) == "usb2"
    assert protocol_name(load_config(settings=["profile=usb1_0112"]).board) == "usb1-112"
    with pytest.raises(ConfigError, match="the messages of RT-DAC4/PCI are not known"):
        protocol_name(load_config(settings=["profile=sim_pci"]).board)


def test_other_frame_numbers_are_not_a_difference_when_their_field_is_named(bench, recorded):
    samples, capture = recorded(RAMP)
    link = CaptureLink(capture, strict=True, numbering=NUMBERING)
    board = RtdacUsb2(link, bench.config.board, bench.clock.now_ns, bench.config.period_ns)
    board._number = 4711  # as in a program that had its board open before the recording began
    with board:
        again = []
        for command in RAMP:
            bench.clock.advance(bench.config.period_ns)
            again.append(board.exchange(command))
    assert again == samples
    assert (link.differences, link.left) == ([], 0)


def test_other_frame_numbers_are_old_answers_when_nothing_is_said(bench, recorded):
    _, capture = recorded(RAMP)
    link = CaptureLink(capture)
    board = RtdacUsb2(link, bench.config.board, bench.clock.now_ns, bench.config.period_ns)
    board._number = 4711
    with pytest.raises(BoardError), board:
        pass
    assert link.differences[0].fields == (NUMBERING,)


def test_another_duty_is_a_difference_with_its_place_its_name_and_both_values(bench, recorded):
    _, capture = recorded(RAMP)
    changed = [*RAMP[:20], Command(RAMP[20].drive + 0.25, 0.0), *RAMP[21:]]
    link = CaptureLink(capture)
    samples = drive(bench, link, changed)
    (difference,) = link.differences
    assert (difference.place, difference.byte_offset, difference.fields) == ("w22", 44, ("pwm0_width",))
    assert int(difference.ours, 16) - int(difference.captured, 16) == 63
    assert "w22 at byte 44 (pwm0_width): captured 0x00AA, ours 0x00E9" in str(difference)
    assert samples[20].board_flags == BoardFlags.STALE  # the captured board echoes the captured command


def test_strict_raises_the_first_difference_and_no_other():
    link = CaptureLink(capture_of(*[out(encode_send({}))] * 3), strict=True)
    link.write(encode_send({}))
    with pytest.raises(CaptureError, match="message 2, w22 at byte 44"):
        link.write(encode_send({"pwm0_width": 7}))
    link.write(encode_send({"pwm0_width": 8}))
    assert link.differing == 2


def test_a_capture_that_is_used_up_says_how_many_messages_it_held(bench, recorded):
    _, capture = recorded(RAMP[:3])
    held = sum(record.kind in {RecordKind.OUT, RecordKind.IN} for record in capture.records)
    link = CaptureLink(capture)
    with pytest.raises(UnsafeError, match=f"no more SEND: it has {held} messages"):
        drive(bench, link, RAMP)


@pytest.mark.parametrize("read", [True, False])
def test_an_empty_capture_answers_nothing_and_compares_nothing(read):
    link = CaptureLink(Capture("usb2", "", "", ()))
    with pytest.raises(LinkError, match="it has 0 messages"):
        link.read(FRAME_BYTES) if read else link.write(READ_REQUEST)


def out(data):
    return Record(0.0, RecordKind.OUT, 2, data)


def into(data):
    return Record(0.0, RecordKind.IN, 0x84, data)


def capture_of(*records, board="usb2"):
    return Capture(board, "", "", records, "x")


def test_frames_are_compared_with_frames_and_requests_with_requests():
    send = encode_send({"pwm0_width": 7})
    link = CaptureLink(capture_of(out(READ_REQUEST), into(encode_read({})), out(send)))
    link.write(send)
    assert link.differences == []
    link.write(READ_REQUEST)
    assert link.read(FRAME_BYTES) == encode_read({})
    assert [(one.place, one.captured, one.ours) for one in link.differences] == [
        ("order", "line 2, a READ request", "only after line 4")
    ]


def test_a_message_of_no_known_role_is_compared_as_a_whole():
    link = CaptureLink(capture_of(out(b"abc"), out(b"abc")))
    link.write(b"abd")
    link.write(b"abcd")
    assert [(one.message, one.place, one.ours) for one in link.differences] == [
        (1, "message", "616264"),
        (2, "length", "4 bytes"),
    ]


def test_a_word_without_a_name_is_unknown():
    send = bytearray(encode_send({}))
    link = CaptureLink(capture_of(out(bytes(send))))
    send[2 * 224] = 5
    link.write(send)
    assert [(one.place, one.fields) for one in link.differences] == [("w224", ("unknown",))]


def test_words_of_the_first_generation_are_named_by_data_byte():
    send = bytearray(b"\x81" + bytes(149))
    link = CaptureLink(capture_of(out(bytes(send)), board="usb1-111"))
    send[1 + 24] = 1
    link.write(send)
    assert [(one.place, one.byte_offset, one.fields) for one in link.differences] == [("b24", 25, ("pwm0_width",))]


def test_notes_and_control_transfers_are_not_replayed():
    notes = Record(0.0, RecordKind.CONTROL, 0, b"x", setup=bytes(8)), Record(0.0, RecordKind.WARNING, text="x")
    link = CaptureLink(capture_of(*notes, into(b"answer"), *notes))
    assert link.left == 1
    assert link.read(3) == b"ans"


def test_differences_beyond_the_list_are_counted():
    link = CaptureLink(capture_of(*[out(encode_send({}))] * 60))
    for _ in range(60):
        link.write(b"\x0f\x8f" + b"\x01\x00" * 251)
    assert len(link.differences) == 10_000
    assert link.differing == 60 * 251


def test_a_message_that_was_not_taken_then_is_compared_and_fails_again():
    send = encode_send({"pwm0_width": 7})
    failed = Record(0.0, RecordKind.ERROR, 2, send, "the cable is unplugged", "out")
    link = CaptureLink(capture_of(failed, out(send)))
    with pytest.raises(LinkError, match="as captured: the cable is unplugged"):
        link.write(send)
    link.write(send)
    assert (link.differences, link.left) == ([], 0)


def test_a_closed_capture_answers_nothing():
    link = CaptureLink(capture_of(into(b"answer")))
    link.close()
    link.close()
    with pytest.raises(LinkError, match="closed"):
        link.read(1)


def test_a_numbering_that_no_frame_carries_is_refused():
    with pytest.raises(ConfigError, match="did you mean pwm7_prescaler"):
        CaptureLink(capture_of(), numbering="pwm7_prescalar")
    with pytest.raises(CaptureError, match="cannot number frames"):
        CaptureLink(capture_of(), numbering="encoder0_count")


def test_a_capture_of_an_unknown_board_is_refused():
    with pytest.raises(ConfigError, match="usb1-111"):
        CaptureLink(capture_of(board="pci"))


class Inner(Link):
    """Answers everything, and notes which of its methods were used."""

    def __init__(self):
        self.used = []
        self.error = None

    def _do(self, what):
        self.used.append(what)
        if self.error is not None:
            raise self.error

    def write(self, _data):
        self._do("write")

    def read(self, length):
        self._do("read")
        return bytes(length)

    def exchange(self, _first, _second, length):
        self._do("exchange")
        return bytes(length)

    def discard(self, _length):
        self._do("discard")

    def close(self):
        self._do("close")


def kinds(link):
    return [(record.kind, record.of, record.data) for record in link.capture().records]


def test_the_inner_links_own_ways_are_used(path):
    inner = Inner()
    link = RecordingLink(inner, path, board="usb2")
    link.write(b"w")
    link.read(1)
    link.exchange(b"a", b"b", 2)
    link.discard(9)
    link.close()
    assert inner.used == ["write", "read", "exchange", "discard", "close"]
    expected = [
        (RecordKind.OUT, "", b"w"),
        (RecordKind.IN, "", b"\0"),
        (RecordKind.OUT, "", b"a"),
        (RecordKind.OUT, "", b"b"),
    ]
    assert kinds(link) == [*expected, (RecordKind.IN, "", b"\0\0")]


@pytest.mark.parametrize("error", [LinkError("unplugged"), KeyboardInterrupt()], ids=["failure", "Ctrl-C"])
def test_every_failure_passes_and_is_kept(path, error):
    inner = Inner()
    inner.error = error
    link = RecordingLink(inner, path, board="usb2")
    for use in (lambda: link.write(b"w"), lambda: link.read(1), lambda: link.exchange(b"a", b"b", 2)):
        with pytest.raises(type(error)):
            use()
    assert kinds(link) == [
        (RecordKind.ERROR, "out", b"w"),
        (RecordKind.ERROR, "in", b""),
        (RecordKind.OUT, "", b"a"),
        (RecordKind.OUT, "", b"b"),
        (RecordKind.ERROR, "exchange", b""),
    ]
    assert {record.text for record in link.capture().records} == {"", str(error) or "KeyboardInterrupt"}


def test_a_message_may_be_reused_by_its_writer(path):
    link = RecordingLink(Inner(), path, board="usb2")
    message = bytearray(b"one")
    link.write(message)
    message[:] = b"two"
    assert kinds(link) == [(RecordKind.OUT, "", b"one")]


def test_nothing_is_written_until_it_is_saved_and_closing_does_not_wait_for_that(path):
    link = RecordingLink(Inner(), path, board="usb2")
    link.write(b"w")
    link.close()
    assert not path.exists()
    link.save()
    assert read_capture(path).messages == 1
    link.write(b"w")
    link.save()
    assert read_capture(path).messages == 2


class TestRecording:
    def test_what_passes_is_saved_in_the_end(self, path):
        with record_wire(path, load_config()) as around:
            around(Inner()).write(b"w")
            assert not path.exists()
        assert read_capture(path).messages == 1

    def test_without_a_path_nothing_is_put_around_the_link(self):
        inner = Inner()
        with record_wire(None, load_config()) as around:
            assert around(inner) is inner

    def test_without_a_path_it_may_be_kept_for_another_place(self, tmp_path):
        with record_wire(None, load_config(), now_ns=lambda: 7, keep=True) as around:
            assert around.capture() is None
            around(Inner()).write(b"w")
            capture = around.capture()
        assert (capture.start_ns, [record.data for record in capture.records]) == (7, [b"w"])
        assert not list(tmp_path.iterdir())

    def fail(self, path, then=lambda: None):
        with record_wire(path, load_config()) as around:
            around(Inner()).write(b"w")
            then()
            raise LinkError("gone")

    def test_a_visit_that_fails_is_saved_and_raises_its_own_error(self, path):
        with pytest.raises(LinkError, match="gone"):
            self.fail(path)
        assert read_capture(path).messages == 1

    def test_a_file_that_cannot_be_written_does_not_hide_how_the_visit_ended(self, tmp_path):
        folder = tmp_path / "folder"
        folder.mkdir()
        with pytest.raises(LinkError, match="gone") as error:
            self.fail(folder / "x.jsonl", folder.rmdir)
        assert "cannot be written" in error.value.__notes__[0]

    def test_a_target_that_exists_is_refused_before_the_board_is_opened(self, path):
        path.write_text("precious")
        with pytest.raises(CaptureError, match="never overwritten"), record_wire(path, load_config()):
            raise AssertionError


def test_the_beginning_is_kept_and_the_rest_counted(path):
    link = RecordingLink(Inner(), path, most_messages=3, board="usb2")
    for number in range(10):
        link.write(bytes([number]))
    link.save()
    capture = read_capture(path)
    assert [record.data for record in capture.records[:3]] == [b"\0", b"\1", b"\2"]
    assert [record.text for record in capture.records[3:]] == ["7 more messages were not recorded: the limit is 3"]
    assert link.dropped == 7


def test_times_are_of_handing_over_and_of_arrival(path, bench):
    link = RecordingLink(Inner(), path, now_ns=bench.clock.now_ns, endpoints=(2, 0x84), board="usb2")
    bench.clock.advance(1_500_000)
    link.write(b"w")
    bench.clock.advance(500_000)
    link.read(1)
    assert [(record.t_s, record.endpoint) for record in link.capture().records] == [
        (pytest.approx(0.0015), 2),
        (pytest.approx(0.002), 0x84),
    ]


def test_a_target_that_exists_is_refused_before_anything_passes(path):
    path.write_text("precious")
    with pytest.raises(CaptureError, match="never overwritten"):
        RecordingLink(Inner(), path, board="usb2")
