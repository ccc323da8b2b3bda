"""The server: who gets in, what it gives away, and a whole run over HTTP and a websocket."""

import json
from contextlib import contextmanager

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from inteco_abs.browser import server as server_module
from inteco_abs.sessions import read_session

EVERY = ("/", "/page.js", "/page.css", "/choices", "/sessions", "/sessions/a.mcap", "/live")
POSTED = ("/run", "/change", "/stop")


@contextmanager
def live(server, **headers):
    with connect(
        f"ws://127.0.0.1:{server.port}/live",
        additional_headers={"Authorization": f"Bearer {server.token}", **headers},
        open_timeout=30,
    ) as socket:
        yield socket


def run_to_the_end(server, **asked):
    """Lines of a run from its beginning on, for one who watches from before."""
    with live(server) as socket:
        status, _, text = server.ask("/run", {"virtual": True, **asked})
        assert status == 200, text
        name, lines = json.loads(text)["session"], []
        while not lines or "end" not in lines[-1]:
            line = json.loads(socket.recv(60))
            if lines or line.get("begin") == name:  # before that come those of an earlier run
                lines.append(line)
        return lines


@pytest.mark.parametrize("path", [*EVERY, *POSTED])
@pytest.mark.parametrize("token", ["", "wrong", "ünknown".encode().decode("latin-1"), "\xff"])
def test_without_the_token_nothing_is_given_or_done(server, path, token):
    body = {} if path in POSTED else None
    status, headers, text = server.ask(path, body, token=token)
    assert status == 401
    assert "the terminal shows" in text
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert server.token not in text


def test_the_address_of_the_terminal_gives_a_cookie_and_leaves_the_history(server):
    status, headers, _ = server.ask(f"/?token={server.token}", token="")
    cookie = headers["Set-Cookie"]
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly" in cookie
    assert "SameSite=Lax" in cookie
    assert cookie.startswith(f"inteco-abs-{server.port}=")  # cookies do not distinguish ports
    status, headers, text = server.ask("/", token="", Cookie=cookie.partition(";")[0])
    assert status == 200
    assert headers["Content-Type"].startswith("text/html")
    assert "script-src 'self'" in headers["Content-Security-Policy"]
    assert '<script src="page.js" defer>' in text
    assert server.ask("/?token=wrong", token="")[0] == 401


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1", 200),
        ("127.0.0.1:9000", 200),  # as through a tunnel
        ("[::1]:9000", 200),
        ("localhost", 200),
        ("192.168.1.5:8770", 200),  # a number is nobody's page
        ("evil.example", 403),
        ("127.0.0.1.evil.example", 403),
        ("[", 403),
    ],
)
def test_a_name_of_another_site_that_leads_here_is_refused(server, host, status):
    assert server.ask("/choices", host=host)[0] == status


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1"])
def test_a_page_of_another_site_or_port_can_do_nothing(server, origin):
    host = f"127.0.0.1:{server.port}"
    assert server.ask("/stop", {}, host=host, Origin=origin)[0] == 403
    with pytest.raises(InvalidStatus), live(server, Origin=origin):
        pass
    assert server.ask("/choices", host=host, Origin=f"http://{host}")[0] == 200


@pytest.mark.parametrize(
    "name",
    ["..%2f..%2fetc%2fpasswd", "%2fetc%2fpasswd", "..", "%2e%2e", "notes.txt", "link.mcap", "none.mcap", "a%00.mcap",
     "folder.mcap", "%ff.mcap"],
)  # fmt: skip
def test_only_sessions_of_the_folder_are_files_that_it_gives_away(server, tmp_path, name):
    (server.folder / "notes.txt").write_text("mine")
    (server.folder / "folder.mcap").mkdir(exist_ok=True)
    (tmp_path / "outside.mcap").write_text("mine")
    (server.folder / "link.mcap").unlink(missing_ok=True)
    (server.folder / "link.mcap").symlink_to(tmp_path / "outside.mcap")
    for page in ("", "/report.html", "/figure.svg"):
        status, _, text = server.ask(f"/sessions/{name}{page}")
        assert status == 404
        assert "mine" not in text


@pytest.mark.parametrize("path", ["/page.py", "/server.py", "/page.html", "/static/../server.py"])
def test_no_other_part_of_the_package_is_served(server, path):
    assert server.ask(path)[0] == 404


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"\xff", b"[" * 10_000])
def test_a_body_that_is_no_object_is_refused(server, body):
    for path in ("/run", "/change"):
        status, _, text = server.ask(path, body)
        assert (status, "must be a JSON object" in text) == (400, True)


def test_a_body_beyond_reason_is_not_read(server):
    assert server.ask("/run", b" " * (1 << 15))[0] == 413


def test_what_is_not_a_choice_starts_nothing(server):
    status, _, text = server.ask("/run", {"gains": {"Mkk": 1.0}})
    assert status == 400
    assert "nothing was started" in text
    assert "did you mean Mk?" in text


def test_without_a_run_there_is_nothing_to_stop_or_change(server):
    assert server.ask("/stop", {})[0] == 409
    assert server.ask("/change", {"name": "Mk", "value": 1.0})[0] == 409
    assert server.ask("/change", {"name": "stop\nMk", "value": 1.0})[0] == 400
    assert server.ask("/change", {"name": "Mk", "value": "1\nstop"})[0] == 400


def test_viewers_are_few(server, monkeypatch):
    monkeypatch.setattr(server_module, "_MOST_VIEWERS", 0)
    assert server.ask("/live")[0] == 503


def test_a_run_is_seen_to_its_end_and_is_then_in_the_list(server):
    lines = run_to_the_end(server, gains={"Mk": 5.0}, seed=3)
    assert "--set=controller.gains.Mk=5.0" in lines[0]["command"]
    assert lines[-1] == {"end": 0}
    (card,) = (line["card"] for line in lines if "card" in line)
    points = [point for line in lines for point in line.get("points", ())]
    assert card["outcome"] == "completed"
    assert points[-1][0] > 0.5
    session = read_session(server.folder / lines[0]["begin"])
    assert session.metadata["software"]["seed"] == "3"
    _, _, text = server.ask("/sessions")
    rows = {row["session"]: row for row in json.loads(text)}
    assert rows[lines[0]["begin"]]["Mk"] == 5.0
    with live(server) as late:  # who comes later gets the same lines
        again = [json.loads(late.recv(30)) for _ in range(len(lines) + 1)]
    assert again[0] == lines[0]
    assert again[1:] == lines
    assert server.ask(f"/sessions/{lines[0]['begin']}")[1]["Content-Disposition"] == "attachment"


@pytest.mark.long
def test_a_run_that_cannot_start_says_why_to_browser_and_terminal(server):
    lines = run_to_the_end(server, rig="nosuch:1")
    assert lines[-1] == {"end": 2}
    said = "\n".join(line["message"] for line in lines if "message" in line)
    assert "no population 'nosuch'" in said
    assert said.splitlines()[0] in server.messages


@pytest.mark.long
def test_a_report_that_cannot_be_made_says_why(server):
    (server.folder / "broken.mcap").write_bytes(b"not a session")
    status, headers, text = server.ask("/sessions/broken.mcap/figure.svg")
    assert status == 500
    assert "broken.mcap" in text
    assert headers["X-Content-Type-Options"] == "nosniff"
