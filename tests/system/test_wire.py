import json

import pytest
from usb_monitor import Usbmon, UsbPcap, pcap, pcapng

from firmware_protocol.rtdac_usb2 import READ_REQUEST, encode_read, encode_send

SLIDER = 45


@pytest.fixture
def inteco_abs(main_here):
    return main_here


def word(frame, index, value):
    return frame[: 2 * index] + value.to_bytes(2, "little") + frame[2 * index + 2 :]


def vendor_session(monitor, slider=(), **device):
    """READ, SEND, as the vendor's programs do it; `slider` are values that an unknown word takes, each for a while."""
    packets = [*monitor.out(0x06, b"bits", **device)]
    tick = 0
    for value in [0, *slider]:
        for _ in range(10):
            tick += 1
            answer = encode_read({"logic_version": 0x0103, "encoder0_count": 3 * tick, "application_name": "ABS"})
            packets += monitor.out(0x02, READ_REQUEST, **device)
            packets += monitor.into(0x84, answer, **device)
            packets += monitor.out(0x02, word(encode_send({"pwm0_prescaler": 44}), SLIDER, value), **device)
    return packets


@pytest.fixture(params=[(Usbmon, pcapng), (UsbPcap, pcap)], ids=["usbmon", "usbpcap"])
def imported(request, inteco_abs, tmp_path):
    make, container = request.param

    def run(name, slider):
        monitor = make()
        (tmp_path / f"{name}.pcap").write_bytes(container(vendor_session(monitor, slider), monitor.link_type))
        inteco_abs("wire", "import", f"{name}.pcap", "-o", f"{name}.jsonl", check=0)
        return f"{name}.jsonl"

    return run


def test_an_unknown_word_is_found_from_a_capture_in_which_one_slider_moves(imported, inteco_abs):
    file = imported("slider", [100, 200, 300])
    found = json.loads(inteco_abs("wire", "changes", file, "--json", check=0).stdout)
    first, *others = found["moved"]
    assert (first["direction"], first["word"], first["fields"]) == ("SEND", f"w{SLIDER}", ["unknown"])
    assert (first["minimum"], first["maximum"], first["course"]) == (0, 300, "rises")
    assert [(other["word"], other["restless"]) for other in others] == [("w53", True)]
    assert f"w{SLIDER}" in inteco_abs("wire", "changes", file, check=0).stdout


def test_programming_the_fpga_is_reported_at_import_and_left_out(inteco_abs, tmp_path):
    monitor = Usbmon()
    (tmp_path / "x.pcap").write_bytes(pcap(vendor_session(monitor), monitor.link_type))
    run = inteco_abs("wire", "import", "x.pcap", "-o", "x.jsonl", check=0)
    assert "endpoint 0x06 programs the FPGA" in run.stderr
    assert b"bits".hex() not in (tmp_path / "x.jsonl").read_text()


def test_a_capture_is_shown_with_its_counts_and_its_board(imported, inteco_abs):
    file = imported("show", [1])
    shown = json.loads(inteco_abs("wire", "show", file, "--json", check=0).stdout)
    assert {role: one["messages"] for role, one in shown["traffic"].items()} == {
        "READ request": 20,
        "READ answer": 20,
        "SEND": 20,
    }
    assert (shown["logic_version"], shown["application_name"]) == (0x0103, "ABS")
    text = inteco_abs("wire", "show", file, check=0).stdout
    for part in ("logic 0x0103 'ABS'", "READ answer", "20"):
        assert part in text


def test_two_captures_are_compared_and_a_difference_is_an_exit_code(imported, inteco_abs):
    one, other = imported("one", [100]), imported("other", [101])
    assert "none of the pairs differ" in inteco_abs("wire", "diff", one, one, check=0).stdout
    differing = inteco_abs("wire", "diff", one, other, check=4).stdout
    assert "10 of the pairs differ" in differing
    assert "unknown" in differing
    outcome = json.loads(inteco_abs("wire", "diff", one, other, "--json", check=4).stdout)
    assert [(found["word"], found["frames"]) for found in outcome["words"]] == [(f"w{SLIDER}", 10)]


def test_frame_numbers_can_be_left_out_of_a_comparison(inteco_abs, tmp_path):
    for name, first in (("one", 1), ("other", 2)):
        monitor = Usbmon()
        frames = [encode_send({"pwm7_prescaler": number}) for number in range(first, first + 5)]
        packets = [packet for frame in frames for packet in monitor.out(0x02, frame)]
        (tmp_path / f"{name}.pcap").write_bytes(pcap(packets, monitor.link_type))
        inteco_abs("wire", "import", f"{name}.pcap", "-o", f"{name}.jsonl", check=0)
    inteco_abs("wire", "diff", "one.jsonl", "other.jsonl", check=4)
    inteco_abs("wire", "diff", "one.jsonl", "other.jsonl", "--numbering-pwm", 7, check=0)
    inteco_abs("wire", "diff", "one.jsonl", "other.jsonl", "--ignore", "pwm7_prescaler", check=0)


def test_a_capture_without_changes_says_so_and_doubts_the_names_of_another_logic(inteco_abs, tmp_path):
    monitor = UsbPcap()
    packets = 3 * monitor.into(0x84, encode_read({"logic_version": 0x0205}))
    (tmp_path / "x.pcap").write_bytes(pcap(packets, monitor.link_type))
    inteco_abs("wire", "import", "x.pcap", "-o", "x.jsonl", check=0)
    run = inteco_abs("wire", "changes", "x.jsonl", check=0)
    assert "no word of any frame changed" in run.stdout
    assert "the board has logic 0x0205" in run.stderr


def test_a_first_generation_board_is_imported_by_its_protocol(inteco_abs, tmp_path):
    monitor = Usbmon()
    (tmp_path / "x.pcap").write_bytes(pcap(monitor.out(0x02, b"\x80\x81" + bytes(149)), monitor.link_type))
    inteco_abs("wire", "import", "x.pcap", "-o", "x.jsonl", "--protocol", "usb1-111", check=0)
    shown = json.loads(inteco_abs("wire", "show", "x.jsonl", "--json", check=0).stdout)
    assert {role: one["messages"] for role, one in shown["traffic"].items()} == {"other": 1, "SEND": 1}


WRONG = [
    (["import", "none.pcap", "-o", "y.jsonl"], 1, ["none.pcap", "No such file", "name a capture of Wireshark"]),
    (["import", "notes.txt", "-o", "y.jsonl"], 1, ["notes.txt", "not a pcap or pcapng file"]),
    (["import", "two.pcap", "-o", "y.jsonl"], 1, ["1.5, 2.7", "--device"]),
    (["import", "two.pcap", "-o", "notes.txt"], 1, ["notes.txt", "never overwritten"]),
    (["import", "two.pcap", "-o", "nowhere/y.jsonl"], 1, ["nowhere", "does not exist"]),
    (["import", "two.pcap", "-o", "y.jsonl", "--device", "five"], 2, ["five", "as in 1.5"]),
    (["import", "two.pcap", "-o", "y.jsonl", "--protocol", "usb3"], 2, ["usb3", "did you mean usb2?"]),
    (["import", "two.pcap"], 2, ["--out"]),
    (["show", "notes.txt"], 1, ["notes.txt, line 1", "JSON"]),
    (["show", "pci.jsonl"], 2, ["'pci'", "usb2"]),
    (["changes", "none.jsonl"], 1, ["No such file"]),
    (["changes", "two.pcap"], 1, ["wire import first"]),
    (["diff", "x.jsonl", "pci.jsonl"], 2, ["pci", "usb2"]),
    (["diff", "x.jsonl", "x.jsonl", "--ignore", "pwm0_widht"], 2, ["did you mean pwm0_width"]),
    (["diff", "x.jsonl", "x.jsonl", "--numbering-pwm", "8"], 2, ["pwm8_prescaler"]),
    (["shwo", "x.jsonl"], 2, ["shwo"]),
]


@pytest.mark.parametrize(("arguments", "code", "words"), WRONG, ids=lambda value: str(value)[:60])
def test_wrong_input_gets_one_clear_answer(inteco_abs, tmp_path, arguments, code, words):
    monitor = Usbmon()
    two = [packet for device in ((1, 5), (2, 7)) for packet in monitor.out(0x02, encode_send({}), device=device)]
    (tmp_path / "two.pcap").write_bytes(pcap(two, monitor.link_type))
    (tmp_path / "notes.txt").write_text("just text\n")
    head = {"format": "inteco-abs wire", "version": 1, "board": "usb2", "recorded_by": "", "clock": ""}
    (tmp_path / "x.jsonl").write_text(json.dumps(head) + "\n")
    (tmp_path / "pci.jsonl").write_text(json.dumps({**head, "board": "pci"}) + "\n")
    before = set(tmp_path.iterdir())
    run = inteco_abs("wire", *arguments)
    assert run.returncode == code, run.stderr
    for part in words:
        assert part in run.stderr
    assert run.stdout == ""
    assert set(tmp_path.iterdir()) == before
