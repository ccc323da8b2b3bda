"""The server's facts for its user, its addresses, and its end."""

import pytest
from drill import new_host

from inteco_abs.errors import BoardError, ConfigError
from inteco_abs.mock_board import TcpAddress, UnixAddress, UsbIpServer, UsbSpeed, parse_address


@pytest.fixture
def server():
    server = UsbIpServer(new_host(UsbSpeed.HIGH, serial=912_000_007), TcpAddress(port=0))
    yield server
    server.close()


def test_bind_reports_address_ids_and_commands(server):
    facts = server.bind()
    port = facts.address.port
    assert port
    assert facts.bus_id == "1-1"
    assert (facts.vendor_id, facts.product_id, facts.serial, facts.speed) == (0x04B4, 0x8613, 912_000_007, "high")
    assert facts.attach == ("modprobe vhci-hcd", f"usbip --tcp-port {port} attach -r 127.0.0.1 -b 1-1")
    assert facts.detach == ("usbip port", "usbip detach -p 00")


def test_attach_command_at_the_usual_port_and_from_elsewhere():
    host = new_host(UsbSpeed.HIGH)
    assert UsbIpServer(host).facts.attach[1] == "usbip attach -r 127.0.0.1 -b 1-1"
    assert "0.0.0.0" not in UsbIpServer(host, TcpAddress("0.0.0.0")).facts.attach[1]  # noqa: S104


def test_address_in_use(server, tmp_path):
    port = server.bind().address.port
    with pytest.raises(BoardError, match=f"{port}.*another port"):
        UsbIpServer(new_host(UsbSpeed.HIGH), TcpAddress(port=port)).bind()
    path = tmp_path / "taken"
    path.write_text("kept")
    taken = UsbIpServer(new_host(UsbSpeed.HIGH), UnixAddress(path))
    with pytest.raises(BoardError, match="taken"):
        taken.bind()
    taken.close()
    assert path.read_text() == "kept"


def test_must_be_bound(server):
    with pytest.raises(BoardError, match="bound"):
        server.step()


def test_closed_before_and_twice(server):
    server.bind()
    server.close()
    server.serve()
    server.close()


@pytest.mark.parametrize(
    ("text", "address"),
    {
        "": TcpAddress("127.0.0.1", 3240),
        "lab": TcpAddress("lab", 3240),
        "lab:99": TcpAddress("lab", 99),
        ":0": TcpAddress("127.0.0.1", 0),
        "[::1]:5": TcpAddress("::1", 5),
        "[::1]": TcpAddress("::1", 3240),
        "::1": TcpAddress("::1", 3240),
    }.items(),
)
def test_addresses(text, address):
    assert parse_address(text) == address


def test_path(tmp_path):
    assert parse_address(f"unix:{tmp_path}") == UnixAddress(tmp_path)


@pytest.mark.parametrize("text", ["lab:", "lab:x", "lab:-1", "lab:70000", "unix:", "[::1]:x", "lab:²"])
def test_no_addresses(text):
    with pytest.raises(ConfigError, match="--usbip"):
        parse_address(text)
