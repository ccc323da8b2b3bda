"""A server in this process, and requests to it."""

import asyncio
import contextlib
import http.client
import json
import subprocess
import sysconfig
import threading
from pathlib import Path
from queue import Queue
from urllib.parse import urlsplit

from inteco_abs.browser import Served, serve
from inteco_abs.control import CONTROLLERS, reference_gain

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"
QUICK = (
    "--set=experiment.start_speed_rad_s=20.0",
    "--set=experiment.idle_s=0.02",
    "--set=experiment.hold_s=0.05",
)


def served(**more):
    """What a browser may do, with two boards."""
    reference = reference_gain(0.2)._asdict()
    facts = {
        "folder": Path("sessions"),
        "boards": ("sim:", "usb2:123"),
        "controllers": {name: kind.gains for name, kind in CONTROLLERS.items()},
        "estimators": ("kalman", "moving-window"),
        "start": {
            "controller": "reaching-law",
            "estimator": "",
            "reference": reference,
            "speed": 20.0,
            "real_time": True,
        },
        "token": "secret",
    }
    return Served(**{**facts, **more})


class Server:
    """A served folder, and requests to it, by default as of its own page."""

    def __init__(self, folder: Path):
        self.folder = folder
        addresses = Queue()
        self.messages = []
        what = served(arguments=QUICK, boards=("sim:",), folder=folder)
        self._thread = threading.Thread(target=self._serve, args=(what, addresses.put))
        self._thread.start()
        self.address = addresses.get(timeout=30)
        place = urlsplit(self.address)
        self.port = place.port
        self.token = place.query.removeprefix("token=")

    def _serve(self, what, announce):
        async def until_closed():
            self._loop, self._task = asyncio.get_running_loop(), asyncio.current_task()
            await serve(what, announce, self.messages.append)

        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(until_closed())

    def close(self):
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(60)

    def ask(self, path, body=None, *, host="127.0.0.1", token=None, **headers):
        """Status, headers and body of an answer; a `body` is posted."""
        headers = {name.replace("_", "-"): value for name, value in headers.items()}
        headers["Authorization"] = f"Bearer {self.token if token is None else token}"
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            data = body if isinstance(body, bytes | None) else json.dumps(body).encode()
            connection.putrequest("GET" if body is None else "POST", path, skip_host=True)
            for name, value in {"Host": host, **headers, "Content-Length": str(len(data or b""))}.items():
                connection.putheader(name, value)
            connection.endheaders(data)
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read().decode(errors="replace")
        finally:
            connection.close()


@contextlib.contextmanager
def serving_command(folder, *arguments):
    """The command's process, and the address that it prints."""
    words = [COMMAND, "serve", folder, "--port", "0", *arguments]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process, process.stdout.readline().strip()
        finally:
            process.terminate()
