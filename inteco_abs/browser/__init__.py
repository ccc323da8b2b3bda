"""A folder's runs in a browser: start, watch, tune and stop them, and look at those that are there."""

from inteco_abs.browser.served import Served, run_words
from inteco_abs.browser.server import serve

__all__ = ["Served", "run_words", "serve"]
