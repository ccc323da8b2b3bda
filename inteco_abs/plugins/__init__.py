"""Users' controllers: from a file, or from an installed package."""

from typing import Final

from inteco_abs.plugins.beside import late_files, with_files
from inteco_abs.plugins.controllers import Controllers, Origin, installed_controllers
from inteco_abs.plugins.file import FROM_FILE, differs, load_controller
from inteco_abs.plugins.shape import require_controller

__all__ = [
    "FROM_FILE",
    "LOADING_MOST_S",
    "Controllers",
    "Origin",
    "differs",
    "installed_controllers",
    "late_files",
    "load_controller",
    "require_controller",
    "with_files",
]

LOADING_MOST_S: Final = 60.0
"""Time to load and make a user's controller: its code may compile something."""
