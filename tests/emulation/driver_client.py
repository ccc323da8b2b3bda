"""The driver on real libusb, in a process of its own: `python driver_client.py ENGINE`; prints what came of it."""

import json
import sys
import time

from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.transports.usb_transport import open_usb
from inteco_abs.config import load_config
from inteco_abs.signals import BoardFlags, Command


def main(engine):
    config = load_config(settings=[f"usb.engine={engine}"])
    link = open_usb("", config.usb)
    board = RtdacUsb2(link, config.board, time.monotonic_ns, 50_000_000)
    with board:
        samples = []
        for _ in range(100):
            samples.append(board.exchange(Command(1.0, 0.0)))
            time.sleep(0.002)
    found = {
        "link": type(link).__name__,
        "stale": sum(bool(sample.board_flags & BoardFlags.STALE) for sample in samples),
        "counts": samples[-1].road_count,
        "name": board.identity.application_name,
    }
    json.dump(found, sys.stdout)


main(sys.argv[1])
