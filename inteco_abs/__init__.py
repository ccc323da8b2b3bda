"""Open driver, controller and laboratory for the Inteco anti-lock braking rig."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inteco_abs.notebook import Rig, Session, connect, open_session, run_stop
    from inteco_abs.version import __version__

__all__ = ["Rig", "Session", "__version__", "connect", "open_session", "run_stop"]


def __getattr__(name: str) -> Any:
    """What notebooks use, and the version, when they ask: the command starts without them."""
    if name == "__version__":
        return import_module("inteco_abs.version").__version__
    if name in __all__:
        return getattr(import_module("inteco_abs.notebook"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
