"""Addresses of a USB/IP server: HOST:PORT, or unix:PATH."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Final, NamedTuple

from inteco_abs.errors import BoardError, ConfigError, ConfigIssue
from inteco_abs.posix import require_posix

USBIP_PORT: Final = 3240
"""Default port of the `usbip` command."""
LOOPBACK: Final = "127.0.0.1"


class TcpAddress(NamedTuple):
    """Address of this computer and port; 0 is any free port. USB/IP has no password: stay on loopback."""

    host: str = LOOPBACK
    port: int = USBIP_PORT

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def listen(self) -> socket.socket:
        """Return a listening socket. Raises BoardError."""
        try:
            family, _, _, _, place = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)[0]
            return socket.create_server(place[:2], family=family, backlog=8)
        except OSError as error:
            raise BoardError(
                f"the USB/IP server cannot listen on {self.host} port {self.port}: {error.strerror or error}; "
                "is a mock board or usbipd running already? choose another port with HOST:PORT"
            ) from error


class UnixAddress(NamedTuple):
    """Path of a Unix stream socket."""

    path: Path

    def listen(self) -> socket.socket:
        """Return a listening socket. Raises BoardError."""
        require_posix("a Unix socket", "serve it at HOST:PORT")
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.bind(str(self.path))
            listener.listen(8)
        except OSError as error:
            listener.close()
            raise BoardError(f"the USB/IP server cannot listen on {self.path}: {error.strerror or error}") from error
        return listener


def parse_address(text: str) -> TcpAddress | UnixAddress:
    """Parse "", "HOST", "HOST:PORT", "[IPv6]:PORT", ":PORT" or "unix:PATH". Raises ConfigError."""
    if text.startswith("unix:"):
        if len(text) > len("unix:"):
            return UnixAddress(Path(text.removeprefix("unix:")))
        raise ConfigError([ConfigIssue("--usbip", "'unix:' must be followed by a path")])
    host, port = text, str(USBIP_PORT)
    if text.startswith("["):
        host, _, rest = text[1:].partition("]")
        port = rest.removeprefix(":") or port
    elif text.count(":") == 1:
        host, port = text.split(":")
    if not port.isascii() or not port.isdigit() or int(port) > 0xFFFF:
        raise ConfigError([ConfigIssue("--usbip", f"{text!r}: {port!r} is not a port, must be 0..65535")])
    return TcpAddress(host or LOOPBACK, int(port))
