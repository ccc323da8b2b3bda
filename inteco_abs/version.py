"""Version of the package, and the folder of its source: no layer imports the top package for them."""

from importlib.metadata import version
from pathlib import Path
from typing import Final

__version__: Final = version("inteco-abs")
SOURCE_FOLDER: Final = Path(__file__).parent
"""Where the package lies."""
