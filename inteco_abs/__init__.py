"""Open driver, controller and laboratory for the Inteco anti-lock braking rig."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inteco_abs.notebook import Rig, Session, connect, open_session, run_stop

__version__ = version("inteco-abs")
__all__ = ["Rig", "Session", "__version__", "connect", "open_session", "run_stop"]


def __getattr__(name: str) -> Any:
    """What notebooks use, when they ask: the command starts without it."""
    if name in __all__:
        return getattr(import_module("inteco_abs.notebook"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
