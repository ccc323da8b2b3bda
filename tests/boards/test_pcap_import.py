import importlib.util
import io

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from usb_monitor import LINUX_USB_MMAPPED, Usbmon, UsbPcap, pcap, pcapng

from inteco_abs.errors import CaptureError, ConfigError
from inteco_abs.wire.capture import RecordKind, read_capture, write_capture
from inteco_abs.wire.pcap import import_pcap

SEND = b"\x0f\x8f" + bytes(502)
REQUEST = bytes.fromhex("ff8f0000")
ANSWER = b"\x03\x01" + bytes(range(200)) * 2 + bytes(102)
MONITORS = {
    "usbmon, 64 bytes": Usbmon,
    "usbmon, 48 bytes": lambda: Usbmon(mmapped=False),
    "usbmon, big-endian": lambda: Usbmon(big_endian=True),
    "USBPcap": UsbPcap,
}
CONTAINERS = {
    "pcap": pcap,
    "pcap, ns": lambda packets, link_type, order: pcap(packets, link_type, order=order, nano=True),
    "pcapng": pcapng,
}


@pytest.fixture(params=MONITORS)
def monitor(request):
    return MONITORS[request.param]()


@pytest.fixture(params=CONTAINERS)
def container(request):
    return CONTAINERS[request.param]


@pytest.fixture
def imported(tmp_path):
    def run(packets, monitor, container=pcap, **options):
        path = tmp_path / "vendor.pcap"
        path.write_bytes(container(packets, monitor.link_type, order=monitor.order))
        return import_pcap(path, **options)

    return run


def tick(monitor, **device):
    return [
        *monitor.out(0x02, SEND, **device),
        *monitor.out(0x02, REQUEST, **device),
        *monitor.into(0x84, ANSWER, **device),
    ]


def seen(capture):
    return [(record.kind, record.endpoint, record.data) for record in capture.records]


def test_a_ticks_three_messages_come_out_of_every_monitor_and_container(imported, monitor, container):
    capture = imported(tick(monitor), monitor, container)
    assert seen(capture) == [(RecordKind.OUT, 2, SEND), (RecordKind.OUT, 2, REQUEST), (RecordKind.IN, 0x84, ANSWER)]


def test_outgoing_message_has_its_start_time_and_an_answer_its_end_time(imported, monitor, container):
    capture = imported(tick(monitor), monitor, container)
    assert [record.t_s for record in capture.records] == pytest.approx([0.0, 0.001, 0.0025], abs=2e-6)


def test_an_import_can_be_written_and_read_again(imported, tmp_path):
    capture = imported(tick(Usbmon()), Usbmon())
    write_capture(tmp_path / "x.jsonl", capture)
    assert seen(read_capture(tmp_path / "x.jsonl")) == seen(capture)
    assert "device 1.5" in capture.recorded_by


def test_other_devices_are_left_out(imported, monitor):
    stick = [*monitor.out(0x02, b"USBC" + bytes(27), device=(1, 3)), *monitor.into(0x81, bytes(512), device=(1, 3))]
    assert len(imported([*stick, *tick(monitor), *stick], monitor).records) == 3


def test_one_of_two_boards_must_be_named(imported, monitor):
    packets = [*tick(monitor), *tick(monitor, device=(2, 17))]
    with pytest.raises(CaptureError, match=r"1\.5, 2\.17; choose one with --device"):
        imported(packets, monitor)
    assert len(imported(packets, monitor, device="2.17").records) == 3


def test_without_a_board_the_devices_are_listed(imported, monitor):
    packets = monitor.out(0x01, b"print me", device=(3, 4))
    with pytest.raises(CaptureError, match=r"3\.4 \(1 on endpoint 0x01\)"):
        imported(packets, monitor)


def test_an_unknown_device_name_lists_the_devices_found(imported, monitor):
    with pytest.raises(CaptureError, match=r"no packets of device 9\.9.*1\.5 \(2 on endpoint 0x02\)"):
        imported(tick(monitor), monitor, device="9.9")


def test_a_named_device_that_does_not_talk_like_a_board_is_refused(imported, monitor):
    packets = [*tick(monitor), *monitor.out(0x01, b"print me", device=(3, 4))]
    with pytest.raises(CaptureError, match=r"device 3\.4 has no messages"):
        imported(packets, monitor, device="3.4")


@pytest.mark.parametrize("device", ["1", "1.", ".5", "one.five", "1.5.2", "1.٥"])
def test_a_device_that_is_not_a_bus_and_address_is_wrong_usage(imported, device):
    with pytest.raises(ConfigError, match=r"as in 1\.5"):
        imported(tick(Usbmon()), Usbmon(), device=device)


def test_an_unknown_protocol_is_wrong_usage(imported):
    with pytest.raises(ConfigError, match="did you mean usb2"):
        imported(tick(Usbmon()), Usbmon(), board="usb3")


def test_a_failed_message_out_becomes_an_error_in_its_place(imported, monitor):
    capture = imported([*tick(monitor), *monitor.out(0x02, SEND, status=-32 % (1 << 31))], monitor)
    assert [record.kind for record in capture.records] == [
        RecordKind.OUT,
        RecordKind.OUT,
        RecordKind.IN,
        RecordKind.ERROR,
    ]
    assert (capture.records[-1].of, capture.records[-1].data) == ("out", SEND)


def test_a_failed_answer_raises_an_error(imported, monitor):
    capture = imported([*tick(monitor), *monitor.into(0x84, b"", status=5)], monitor)
    assert (capture.records[-1].kind, capture.records[-1].of) == (RecordKind.ERROR, "in")


def test_transfer_numbers_are_used_again(imported):
    monitor = Usbmon()
    monitor.numbers = iter([7] * 10)
    assert len(imported([*tick(monitor), *tick(monitor)], monitor).records) == 6


def test_a_failure_whose_message_was_not_captured_is_not_laid_on_an_earlier_one(imported):
    monitor = Usbmon()
    monitor.numbers = iter([7] * 10)
    capture = imported([*tick(monitor), monitor.packet(7, "C", 0x02, status=-32)], monitor)
    assert [record.kind for record in capture.records] == [RecordKind.OUT, RecordKind.OUT, RecordKind.IN]


def test_data_that_arrived_before_a_failure_are_kept(imported, monitor):
    capture = imported([*tick(monitor), *monitor.into(0x84, b"some", status=5)], monitor)
    assert seen(capture)[-1] == (RecordKind.IN, 0x84, b"some")


def test_programming_the_fpga_is_noted_once_and_never_kept(imported, monitor):
    jtag = [*monitor.out(0x06, b"bits"), *monitor.out(0x06, b"bits"), *monitor.into(0x88, b"bits")]
    capture = imported([*jtag, *tick(monitor)], monitor)
    warnings = [record.text for record in capture.records if record.kind is RecordKind.WARNING]
    assert [text[:13] for text in warnings] == ["endpoint 0x06", "endpoint 0x88"]
    assert not any(b"bits" in record.data for record in capture.records)
    assert {record.endpoint for record in capture.records if record.kind in {RecordKind.OUT, RecordKind.IN}} == {
        0x02,
        0x84,
    }


def test_control_transfers_are_kept_with_request_and_data(imported, monitor):
    asked = bytes.fromhex("c0d9000000000600")
    blink = bytes.fromhex("40df000000000000")
    capture = imported([*monitor.control(asked, b"123456"), *monitor.control(blink, b""), *tick(monitor)], monitor)
    assert [(record.setup, record.data) for record in capture.records if record.kind is RecordKind.CONTROL] == [
        (asked, b"123456"),
        (blink, b""),
    ]


def test_data_that_the_monitor_did_not_keep_are_warned_of(imported):
    monitor = Usbmon()
    lost = [
        monitor.packet(1, "S", 0x02, status=-115, length=504, flag_data=ord("D")),
        monitor.packet(2, "C", 0x84, length=504, flag_data=ord("D")),
    ]
    capture = imported([*tick(monitor), *lost], monitor)
    assert ["504 bytes were" in record.text for record in capture.records[3:]] == [True, True]


def test_a_network_capture_is_refused_by_its_link_type(tmp_path):
    path = tmp_path / "net.pcap"
    path.write_bytes(pcap([bytes(60)], 1))
    with pytest.raises(CaptureError, match="link type 1 is not a USB monitor's; 189 is usbmon"):
        import_pcap(path)


def test_a_network_packet_in_a_usb_capture_is_named(imported):
    monitor = Usbmon()
    with pytest.raises(CaptureError, match=r"packet 7 is not a usbmon packet.*several interfaces"):
        imported([*tick(monitor), bytes(90)], monitor)


def test_a_missing_library_is_an_error_that_names_the_extra(imported, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    monkeypatch.setattr("inteco_abs.wire.pcap.find_spec", lambda _name: None)
    with pytest.raises(CaptureError, match=r"pip install inteco-abs\[capture\]"):
        imported(tick(Usbmon()), Usbmon())


@pytest.mark.parametrize("data", [b"", b"text\n" * 20, b"\x0a\x0d\x0d\x0a", b"\x1f\x8b" + bytes(100)])
def test_a_file_that_is_not_a_capture_is_one_clear_error(tmp_path, data):
    path = tmp_path / "vendor.pcap"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=r"vendor\.pcap: not a pcap or pcapng file"):
        import_pcap(path)


def test_a_capture_without_packets_says_so(imported, container):
    with pytest.raises(CaptureError, match="no packets"):
        imported([], Usbmon(), container)


def test_a_missing_file_and_a_folder_are_clear_errors(tmp_path):
    for path in (tmp_path / "none.pcap", tmp_path):
        with pytest.raises(CaptureError, match="cannot be read"):
            import_pcap(path)


def test_files_of_the_librarys_own_writer_are_read(tmp_path):
    from dpkt import pcapng as writer

    monitor, buffer = Usbmon(), io.BytesIO()
    out = writer.Writer(buffer, linktype=LINUX_USB_MMAPPED)
    for number, packet in enumerate(tick(monitor)):
        out.writepkt(packet, ts=1_700_000_000 + number)
    path = tmp_path / "vendor.pcapng"
    path.write_bytes(buffer.getvalue())
    assert len(import_pcap(path).records) == 3


@pytest.mark.parametrize("monitor", [Usbmon(), UsbPcap()], ids=["usbmon", "usbpcap"])
@pytest.mark.parametrize("container", [pcap, pcapng])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_gives_records_or_one_clear_error(tmp_path, monitor, container, data):
    image = bytearray(container(tick(monitor), monitor.link_type))
    for _ in range(data.draw(st.integers(0, 4))):
        image[data.draw(st.integers(0, len(image) - 1))] = data.draw(st.integers(0, 255))
    length = data.draw(st.integers(0, len(image)))
    path = tmp_path / "vendor.pcap"
    path.write_bytes(image[:length])
    try:
        records, problem = import_pcap(path).records, ""
    except CaptureError as error:
        records, problem = (), str(error)
    assert records or problem.startswith(str(path))


@pytest.mark.parametrize("container", [pcap, pcapng])
def test_a_file_cut_anywhere_inside_a_packet_is_an_error(tmp_path, container):
    monitor = Usbmon()
    image = container(tick(monitor), monitor.link_type)
    path = tmp_path / "vendor.pcap"
    for cut in (1, 300, 570):
        path.write_bytes(image[:-cut])
        with pytest.raises(CaptureError, match="truncated"):
            import_pcap(path)
