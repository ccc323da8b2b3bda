"""Open driver, controller and laboratory for the Inteco anti-lock braking rig."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inteco_abs.api.design import design
    from inteco_abs.api.identify import identify
    from inteco_abs.api.rig import Rig, connect, run_stop
    from inteco_abs.api.session import Session, open_session
    from inteco_abs.api.sweep import Sweep, sweep
    from inteco_abs.errors import AbsError
    from inteco_abs.realtime import Tuner
    from inteco_abs.version import __version__

__all__ = [
    "AbsError",
    "Rig",
    "Session",
    "Sweep",
    "Tuner",
    "__version__",
    "connect",
    "design",
    "identify",
    "open_session",
    "run_stop",
    "sweep",
]

_MODULES = {
    "AbsError": "errors",
    "Rig": "api.rig",
    "Session": "api.session",
    "Sweep": "api.sweep",
    "Tuner": "realtime",
    "__version__": "version",
    "connect": "api.rig",
    "design": "api.design",
    "identify": "api.identify",
    "open_session": "api.session",
    "run_stop": "api.rig",
    "sweep": "api.sweep",
}
"""Where each name is. They are imported when they are used: the command, and the processes of a run, start without."""


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"inteco_abs.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """What completion offers: the interface alone."""
    return [*__all__, "__doc__", "__file__", "__name__", "__path__"]
