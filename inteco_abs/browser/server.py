"""The web server of `inteco-abs serve`: pages and files of one folder, and at most one run at a time.

A run is the command `inteco-abs run --stdio` in a process of its own, so that a browser can do no more than a terminal,
and nothing that a browser or this server does reaches the loop. When this server ends, however it does, the command's
standard input ends, and that stops the run in SAFE.
"""

from __future__ import annotations

import asyncio
import errno
import hmac
import ipaddress
import json
import shlex
import signal
import socket
import sys
import tempfile
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from aiohttp import web

from inteco_abs.analysis import session_files, session_rows, sort_rows
from inteco_abs.boards import simulated
from inteco_abs.browser.served import Served, finite_number, run_words
from inteco_abs.errors import AbsError, ConfigError

_LARGEST_REQUEST: Final = 1 << 14
_LONGEST_LINE: Final = 1 << 20
_MOST_LINES: Final = 5000
"""Lines of the present or last run that a new viewer gets, the newest: about three minutes."""
_KEPT: Final = ("begin", "gains", "values")
"""Keys of lines without which a viewer cannot show the others."""
_MOST_BEHIND: Final = 200
"""Lines that may wait for a viewer; one that is slower is sent away, and comes back for the newest."""
_MOST_VIEWERS: Final = 16
_LONGEST_STOP_S: Final = 60.0
_MOST_PAGES: Final = 64
"""Reports and figures that are kept until they are asked for again."""
_PARTS: Final = {"page.html": "text/html", "page.js": "text/javascript", "page.css": "text/css"}
_SECURITY: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_SANDBOX: Final = "sandbox allow-scripts allow-downloads"
"""For pages made from sessions, which may be anybody's: their scripts may not act in this server's name."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


async def serve(served: Served, announce: Callable[[str], None], report: Callable[[str], None]) -> None:
    """Serve until it is cancelled, or the process gets SIGTERM or SIGHUP; a run is stopped in SAFE before.

    `announce` gets the address to open, with the token, `report` the messages of runs. Raises AbsError if it cannot be
    served there.
    """
    with tempfile.TemporaryDirectory(prefix="inteco-abs-") as pages:
        server = _Server(served, Path(pages), report)
        runner = web.AppRunner(server.application(), access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, served.host, served.port)
            try:
                await site.start()
            except (OSError, OverflowError) as error:
                raise _not_served(served, error) from error
            server.port = runner.addresses[0][1]
            announce(f"http://{_reachable(served.host)}:{server.port}/?token={served.token}")
            await _until_signalled()
        finally:
            await server.close()
            await runner.cleanup()


def _not_served(served: Served, error: OSError | OverflowError) -> AbsError:
    why = getattr(error, "strerror", None) or str(error)
    if isinstance(error, socket.gaierror) or getattr(error, "errno", None) == errno.EADDRNOTAVAIL:
        return AbsError(f"--host: {served.host} cannot be served: {why}; name an address of this computer")
    other = "name another port, or 0 for any that is free"
    return AbsError(f"--port: {served.host}, port {served.port} cannot be served: {why}; {other}")


async def _until_signalled() -> None:
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            with suppress(NotImplementedError, RuntimeError):  # Windows, or not the main thread
                loop.add_signal_handler(number, over.set)
    await over.wait()


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _reachable(host: str) -> str:
    """The host as another computer writes it: for all addresses of this one, the one that leads to the network."""
    if _is_address(host) and ipaddress.ip_address(host).is_unspecified:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.connect(("192.0.2.1", 9))  # for documentation (RFC 5737): it sends nothing
            return str(probe.getsockname()[0])
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


class _Server:
    """Answers requests for one folder."""

    def __init__(self, served: Served, pages: Path, report: Callable[[str], None]) -> None:
        self.port = served.port
        self._served, self._run, self._pages = served, _Run(report), pages
        self._making = asyncio.Lock()
        own = {served.host, "localhost", socket.gethostname()}
        self._hosts = {name.lower() for name in (*own, f"{socket.gethostname()}.local")}

    def application(self) -> web.Application:
        application = web.Application(client_max_size=_LARGEST_REQUEST, middlewares=[self._guarded])
        application.add_routes(
            [
                web.get("/", self._page),
                web.get("/{part:page\\.(?:js|css)}", self._part),
                web.get("/choices", self._choices),
                web.get("/sessions", self._sessions),
                web.get("/sessions/{name}", self._session),
                web.get("/sessions/{name}/{page:report\\.html|figure\\.svg}", self._made),
                web.get("/live", self._live),
                web.post("/run", self._start),
                web.post("/change", self._change),
                web.post("/stop", self._stop),
            ]
        )
        return application

    async def close(self) -> None:
        """End the run, if there is one, with its board safe."""
        await self._run.end()

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what does not come from a page of this server with its token."""
        try:
            response = self._refusal(request) or await handler(request)
        except web.HTTPException as error:
            error.headers.update(_SECURITY)
            raise
        except AbsError as error:
            response = _said(400, str(error))
        for name, value in _SECURITY.items():
            response.headers.setdefault(name, value)
        return response

    def _refusal(self, request: web.Request) -> web.Response | None:
        if not self._ours(request.host):  # a name that leads here is another's page (DNS rebinding)
            return _said(403, "open this page by the address that the terminal shows")
        origin = request.headers.get("Origin")
        if origin is not None and origin != f"http://{request.host}":
            return _said(403, f"{origin[:100]}: another site may not use this server")
        _, _, bearer = request.headers.get("Authorization", "").partition(" ")
        given = bearer or request.cookies.get(self._cookie, "")
        if request.path == "/" and "token" in request.query:
            given = request.query["token"]
        if not hmac.compare_digest(given.encode(errors="surrogateescape"), self._served.token.encode()):
            return _said(401, "open this page by the address that the terminal shows: it ends in ?token=...")
        return None

    def _ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return _is_address(name) or name.lower() in self._hosts

    @property
    def _cookie(self) -> str:
        return f"inteco-abs-{self.port}"  # cookies do not distinguish ports

    async def _page(self, request: web.Request) -> web.StreamResponse:
        if "token" not in request.query:
            return _packaged("page.html")
        there = web.Response(status=303, headers={"Location": "/"})  # the token must not stay in the address
        there.set_cookie(self._cookie, self._served.token, httponly=True, samesite="Lax")
        return there

    async def _part(self, request: web.Request) -> web.StreamResponse:
        return _packaged(request.match_info["part"])

    async def _choices(self, request: web.Request) -> web.StreamResponse:
        served = self._served
        return _json(
            {
                "folder": str(served.folder),
                "boards": {board: simulated(board) for board in self._served.boards_for(request.remote)},
                "controllers": {name: [gain._asdict() for gain in gains] for name, gains in served.controllers.items()},
                "estimators": served.estimators,
                "start": served.start,
            }
        )

    async def _sessions(self, request: web.Request) -> web.StreamResponse:  # noqa: ARG002  aiohttp's interface
        folder = self._served.folder
        rows = await asyncio.to_thread(session_rows, folder) if folder.is_dir() else []
        newest_first = sort_rows(rows, "started_utc", reverse=True)
        return _json([row | {"session": Path(row["session"]).name} for row in newest_first])

    def _file(self, request: web.Request) -> Path:
        """The session that is named, only if it is listed and in the folder itself; raises HTTPNotFound."""
        folder, name = self._served.folder, request.match_info["name"]
        for path in session_files(folder) if folder.is_dir() else []:
            if path.name == name and path.resolve().parent == folder.resolve():
                return path.resolve()
        raise web.HTTPNotFound(text=f"{name[:100]}: no such session in this folder")

    async def _session(self, request: web.Request) -> web.StreamResponse:
        path = self._file(request)
        named = {"Content-Disposition": "attachment", "Content-Type": "application/octet-stream"}
        return web.FileResponse(path, headers=named)

    async def _made(self, request: web.Request) -> web.StreamResponse:
        """A report or a figure, made by the command; after a run that is under way, which it would disturb."""
        path, page = self._file(request), request.match_info["page"]
        state = path.stat()
        made = self._pages / f"{state.st_ino}-{state.st_mtime_ns}-{page}"
        verb, kind = ("report", "text/html") if page == "report.html" else ("figure", "image/svg+xml")
        if not made.exists():
            async with self._making:
                await self._run.over.wait()
                code, text = (0, "") if made.exists() else await _command(verb, str(path), "-o", str(made))
                if not made.exists():
                    return _said(500, text or f"{verb} ended with exit code {code}")
                for old in sorted(self._pages.iterdir(), key=lambda each: each.stat().st_mtime_ns)[:-_MOST_PAGES]:
                    old.unlink()
        sandboxed = {"Content-Security-Policy": _SANDBOX}
        return web.Response(body=made.read_bytes(), content_type=kind, charset="utf-8", headers=sandboxed)

    async def _live(self, request: web.Request) -> web.StreamResponse:
        """Send all lines of the present or last run, and those that come."""
        if len(self._run.viewers) >= _MOST_VIEWERS:
            return _said(503, f"{_MOST_VIEWERS} browsers watch already; close one")
        socket = web.WebSocketResponse(heartbeat=10.0, max_msg_size=_LARGEST_REQUEST)
        await socket.prepare(request)
        await self._run.show(socket)
        return socket

    async def _start(self, request: web.Request) -> web.StreamResponse:
        asked = await _asked(request)
        words = [*self._served.arguments, *run_words(asked, self._served, self._served.boards_for(request.remote))]
        if not self._run.over.is_set():
            return _said(409, "a run is under way; stop it first, or wait for its end")
        name = f"stop-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}.mcap"
        begin = {"begin": name, "controller": asked.get("controller") or self._served.start["controller"]}
        await self._run.start([*words, f"--out={self._served.folder / name}"], asked.get("board", "sim:"), begin)
        return _json({"session": name})

    async def _change(self, request: web.Request) -> web.StreamResponse:
        asked = await _asked(request)
        name, value = asked.get("name"), asked.get("value")
        if not (isinstance(name, str) and name.isidentifier()):
            raise ConfigError.of("name", "must be a gain's name")
        if not self._run.over.is_set() and self._run.board not in self._served.boards_for(request.remote):
            return _said(403, "a real rig's gains change from a browser on its own computer only")
        return self._done(f"{name}={finite_number(name, value)!r}")

    async def _stop(self, request: web.Request) -> web.StreamResponse:  # noqa: ARG002  any browser may stop any run
        return self._done("stop")

    def _done(self, command: str) -> web.Response:
        return _json({}) if self._run.command(command) else _said(409, "no run is under way")


class _Run:
    """The command of one run after another, and the viewers of its lines."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self.viewers = set[asyncio.Queue[str]]()
        self.over = asyncio.Event()
        self.over.set()
        self.board = ""
        self._report = report
        self._commands: asyncio.StreamWriter | None = None
        self._following: asyncio.Task[None] | None = None
        self._kept = dict[str, str]()
        self._lines = deque[str](maxlen=_MOST_LINES)

    async def start(self, words: Sequence[str], board: str, begin: Mapping[str, str]) -> None:
        """Start `inteco-abs run` with these words; `begin` is what viewers get first."""
        self.over.clear()
        try:
            process = await _started("run", *words, "--stdio", stdin=asyncio.subprocess.PIPE)
        except OSError as error:
            self.over.set()
            raise AbsError(f"the run cannot be started: {error.strerror or error}") from error
        self.board, self._commands = board, process.stdin
        self._kept.clear()
        self._lines.clear()
        self._send(json.dumps({**begin, "command": shlex.join(["inteco-abs", "run", *words])}))
        self._following = asyncio.create_task(self._follow(process))

    def command(self, line: str) -> bool:
        """Send a command to the run; return whether there is one."""
        if self.over.is_set() or self._commands is None:
            return False
        self._commands.write(f"{line}\n".encode())
        return True

    async def end(self) -> None:
        """Stop the run, and wait until its processes have ended."""
        if self._commands is not None and self._following is not None:
            self._commands.close()
            with suppress(TimeoutError):
                await asyncio.wait_for(asyncio.shield(self._following), _LONGEST_STOP_S)

    async def show(self, socket: web.WebSocketResponse) -> None:
        """Send lines to one viewer until it is gone or too slow."""
        coming = asyncio.Queue[str](_MOST_BEHIND)
        held = [*self._kept.values(), *self._lines]
        self.viewers.add(coming)
        sending = asyncio.create_task(self._send_to(socket, held, coming))
        try:
            async for _ in socket:  # what a viewer says does not matter, only that it is there
                pass
        finally:
            sending.cancel()
            self.viewers.discard(coming)

    async def _send_to(self, socket: web.WebSocketResponse, held: Sequence[str], coming: asyncio.Queue[str]) -> None:
        with suppress(ConnectionError):
            for line in held:
                await socket.send_str(line)
            while coming in self.viewers:
                await socket.send_str(await coming.get())
        await socket.close()

    async def _follow(self, process: asyncio.subprocess.Process) -> None:
        """Hand on the command's lines and the messages of all its processes, until they have ended."""
        await asyncio.gather(self._hand_on(process.stdout), self._hand_on(process.stderr, self._message))
        self._send(json.dumps({"end": await process.wait()}))
        self.over.set()

    async def _hand_on(self, stream: asyncio.StreamReader | None, send: Callable[[str], None] | None = None) -> None:
        while stream is not None:
            try:
                line = await stream.readline()
            except ValueError:  # longer than any that is of use; the rest of it follows
                continue
            if not line:
                return
            (send or self._send)(line.decode("utf-8", "replace").rstrip())

    def _message(self, line: str) -> None:
        with suppress(OSError):  # the terminal is gone
            self._report(line)
        self._send(json.dumps({"message": line}))

    def _send(self, line: str) -> None:
        self._lines.append(line)
        key = line[2 : line.find('"', 2)]
        if key in _KEPT:
            self._kept[key] = line
        for viewer in [*self.viewers]:
            try:
                viewer.put_nowait(line)
            except asyncio.QueueFull:
                self.viewers.discard(viewer)


async def _asked(request: web.Request) -> Mapping[str, Any]:
    """The request's JSON object. Raises ConfigError, and HTTPRequestEntityTooLarge."""
    try:
        asked = await request.json()
    except (ValueError, RecursionError) as error:
        raise ConfigError.of("request", "must be a JSON object") from error
    if not isinstance(asked, dict):
        raise ConfigError.of("request", "must be a JSON object")
    return asked


async def _started(*words: str, stdin: int = asyncio.subprocess.DEVNULL) -> asyncio.subprocess.Process:
    """Start the command of this program in a process of its own, which Ctrl-C in the terminal does not reach."""
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-P",
        "-c",
        "from inteco_abs.cli import main; main()",
        *words,
        stdin=stdin,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        limit=_LONGEST_LINE,
        start_new_session=True,
    )


async def _command(*words: str) -> tuple[int, str]:
    """Exit code and messages of a command."""
    process = await _started(*words)
    try:
        _, messages = await process.communicate()
    except BaseException:
        process.kill()
        raise
    return process.returncode or 0, messages.decode("utf-8", "replace").strip()


def _packaged(name: str) -> web.Response:
    text = resources.files("inteco_abs.browser").joinpath(name).read_text(encoding="utf-8")
    return web.Response(text=text, content_type=_PARTS[name])


def _json(data: object) -> web.Response:
    return web.json_response(data)


def _said(status: int, text: str) -> web.Response:
    return web.Response(status=status, text=text)
