"""Controllers of the user's own: from a file that the user names, or from an installed package."""

from inteco_abs.plugins.controllers import Controllers, Origin
from inteco_abs.plugins.file import FROM_FILE, load_controller
from inteco_abs.plugins.packages import GROUP, Packaged, packaged_controllers

__all__ = [
    "FROM_FILE",
    "GROUP",
    "Controllers",
    "Origin",
    "Packaged",
    "load_controller",
    "packaged_controllers",
]
