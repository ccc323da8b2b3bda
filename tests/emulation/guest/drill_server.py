"""The drill board at a Unix socket, as a process: `python -m guest.drill_server PATH high|full`."""

import sys
from pathlib import Path

from drill import new_host

from inteco_abs.mock_board import UnixAddress, UsbIpServer, UsbSpeed

server = UsbIpServer(new_host(UsbSpeed[sys.argv[2].upper()]), UnixAddress(Path(sys.argv[1])))
server.bind()
server.serve()
