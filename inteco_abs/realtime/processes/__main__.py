"""Entry of the processes that a supervisor starts: `python -m inteco_abs.realtime.processes ROLE MEMORY`."""

import sys
from importlib import import_module
from typing import Final

ROLES: Final = {
    "manual": "manual",
    "controller": "controller",
    "loop": "loop",
    "drill": "drill",
    "guardian": "guardian",
    "recorder": "recorder",
    "trips": "round_trips",
}

if __name__ == "__main__":
    role, memory = sys.argv[1:]
    # each process loads its own part only: the guardian must be small
    sys.exit(import_module(f"inteco_abs.realtime.processes.{ROLES[role]}").main(memory))
