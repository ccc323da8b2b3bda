"""Sessions at an address are read in parts: a server counts requests and bytes."""

import http.server
import re
import threading

import pytest

from inteco_abs.errors import AbsError
from inteco_abs.sessions import open_session, session_path

RANGE = re.compile(r"bytes=(\d+)-(\d*)")


class Ranges(http.server.BaseHTTPRequestHandler):
    """Gives parts of the server's `data`, unless it is `simple`."""

    def do_HEAD(self):
        found = 200 if self.path == "/stop.mcap" else 404
        self._answer(found, {"Accept-Ranges": "bytes"}, self.server.data, head=True)

    def do_GET(self):
        data, wanted = self.server.data, RANGE.fullmatch(self.headers.get("Range", ""))
        if self.path != "/stop.mcap":
            self._answer(404, {}, b"")
        elif wanted is None or self.server.simple:
            self._answer(200, {}, data)
        else:
            first = int(wanted[1])
            part = data[first : int(wanted[2]) + 1 if wanted[2] else None]
            self.server.parts.append(len(part))
            self._answer(206, {"Content-Range": f"bytes {first}-{first + len(part) - 1}/{len(data)}"}, part)

    def _answer(self, code, heads, data, *, head=False):
        self.send_response(code)
        for name, value in {**heads, "Content-Length": str(len(data))}.items():
            self.send_header(name, value)
        self.end_headers()
        if not head:
            self.wfile.write(data)

    def log_message(self, *_words):
        """Say nothing."""


class Server(http.server.ThreadingHTTPServer):
    """One whose clients may leave."""

    def handle_error(self, *_request):
        """Say nothing: a client has what it wanted."""


@pytest.fixture
def server(chunked):
    with Server(("127.0.0.1", 0), Ranges) as server:
        server.data, server.parts, server.simple = chunked.path.read_bytes(), [], False
        server.address = f"http://127.0.0.1:{server.server_port}/stop.mcap"
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


@pytest.fixture
def small_requests(monkeypatch):
    """A short session in parts, as a long one is."""
    monkeypatch.setattr("inteco_abs.sessions.locations._READ_AHEAD", 1 << 13)
    monkeypatch.setattr("inteco_abs.sessions.rows.MOST_IN_MEMORY", 1000)


@pytest.mark.usefixtures("small_requests")
def test_a_part_of_a_session_is_read_in_few_requests(server, chunked):
    session = open_session(session_path(server.address))
    assert session.metadata == chunked.session.metadata
    opened = len(server.parts)
    part = session[0.2:0.21]
    assert part.payload == chunked.session[0.2:0.21].payload
    assert opened <= 10
    assert len(server.parts) - opened <= 6


def test_the_verbs_read_an_address(server, verb, tmp_path):
    assert verb("info", server.address, "--json").json["ticks"] > 0
    assert "none differ" in verb("replay", server.address).out
    assert verb("export", server.address, "-o", tmp_path / "stop.npz").code == 0


@pytest.mark.parametrize(("address", "words"), [("{}x", "is not there"), ("http://127.0.0.1:1/x", "does not answer")])
def test_what_is_not_there_is_named(server, verb, address, words):
    done = verb("info", address.format(server.address))
    assert (done.code, done.out) == (1, "")
    assert words in done.err


def test_a_server_that_gives_no_parts_is_named(server, verb):
    server.simple = True
    done = verb("replay", server.address)
    assert (done.code, done.out) == (1, "")
    assert "gives no parts of a file; download it first" in done.err


def test_an_unknown_kind_of_address_names_the_extra():
    with pytest.raises(AbsError, match=r"nowhere://x.*inteco-abs\[remote\]"):
        session_path("nowhere://x")
