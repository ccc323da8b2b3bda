"""Slip controllers that others published for this rig or for wheels in general, each after its source, one file each.

They are known by name wherever a controller is, and imported when they are used. docs/benchmark.md compares them, and
says where a source's gains could not be had.
"""

from typing import Final

PUBLISHED: Final[dict[str, str]] = {}
"""By name, "module:class"."""
