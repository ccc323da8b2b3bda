"""Open driver, controller and laboratory for the Inteco anti-lock braking rig."""

from importlib.metadata import version

__version__ = version("inteco-abs")
