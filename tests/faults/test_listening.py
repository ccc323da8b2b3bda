"""Servers listen on this computer only by default, and no input is ever executed."""

import ast
import ipaddress
import os
import socket
from contextlib import suppress
from pathlib import Path

import pytest

import inteco_abs
from inteco_abs.config import load_config
from inteco_abs.control import control_check
from inteco_abs.errors import AbsError
from inteco_abs.mock_board import Device, UsbBoard, UsbHost, UsbIdentity, UsbIpServer, front_end_of, parse_address

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PACKAGE = Path(inteco_abs.__file__).parent
RUNS_CODE = {"eval", "exec", "compile", "__import__"}
USERS_OWN_FILE = {"plugins/file.py", "course/student.py"}
"""Where a file is run that the user has named on the command line, or that is kept in the user's session; a submission
to the course in a process that has given up its rights."""
OWN_SOURCE = {"c_code.py", "machine_code.py"}
"""Which run parts of the source of functions that are imported already."""
FROM_ITS_PARENT = {"kept_loop.py", "realtime/processes/controller.py"}
"""Which unpickles what the process that started it sends over the pipe that it made for that, and nothing else."""
UNPICKLES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}


def listening_sockets():
    """Local addresses of the TCP sockets on which this process listens."""
    for descriptor in list(Path("/proc/self/fd").iterdir()):
        with suppress(OSError):  # closed meanwhile, or no internet socket
            if str(descriptor.readlink()).startswith("socket:"):
                with socket.socket(fileno=os.dup(int(descriptor.name))) as found:
                    if found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) and found.family == socket.AF_INET:
                        yield found.getsockname()[0]


@pytest.mark.parametrize("address", ["", ":0"])
def test_the_mock_board_on_usbip_listens_on_the_loopback_interface(address):
    front_end = front_end_of(Device(load_config(), lambda: 0))
    server = UsbIpServer(UsbHost(UsbBoard(front_end, UsbIdentity())), parse_address(address)._replace(port=0))
    before = list(listening_sockets())
    server.bind()
    try:
        opened = list(listening_sockets())
    finally:
        server.close()
        server.serve(lambda: None)
    assert len(opened) == len(before) + 1
    assert all(ipaddress.ip_address(each).is_loopback for each in opened)


def test_no_module_unpickles_or_runs_what_it_reads():
    unpickling, running = set(), set()
    for file in PACKAGE.rglob("*.py"):
        name = str(file.relative_to(PACKAGE))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                modules = [getattr(node, "module", None) or "", *(each.name for each in node.names)]
                unpickling |= {name} if {module.partition(".")[0] for module in modules} & UNPICKLES else set()
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in RUNS_CODE:
                running.add(name)
    assert unpickling == FROM_ITS_PARENT
    assert running <= USERS_OWN_FILE | OWN_SOURCE


@pytest.mark.parametrize(
    "text", ["profile=!!python/object/apply:os.system", "controller.name=os:system", "profile=/etc"]
)
def test_a_configuration_names_data_never_code(text):
    with pytest.raises(AbsError):
        load_config(settings=[text], checks=[control_check()])
