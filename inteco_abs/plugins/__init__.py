"""Users' controllers: from a file, or from an installed package."""

from inteco_abs.plugins.controllers import Controllers, Origin, installed_controllers
from inteco_abs.plugins.file import FROM_FILE, load_controller

__all__ = [
    "FROM_FILE",
    "Controllers",
    "Origin",
    "installed_controllers",
    "load_controller",
]
