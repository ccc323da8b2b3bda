"""Entry of the processes that a supervisor starts: `python -m inteco_abs.realtime ROLE MEMORY`."""

import sys
from importlib import import_module
from typing import Final

ROLES: Final = {
    "by-hand": "by_hand",
    "controller": "isolated",
    "loop": "rt",
    "drill": "drill",
    "guardian": "guardian",
    "recorder": "recorder",
    "trips": "trips",
}

if __name__ == "__main__":
    role, memory = sys.argv[1:]
    # each process loads its own part only: the guardian is to be small
    sys.exit(import_module(f"inteco_abs.realtime.{ROLES[role]}").main(memory))
