"""What is kept of a run, byte by byte: the loop packs it, MCAP stores it, numpy reads it, any viewer decodes it."""

from inteco_abs.format.schema import TICK, TRUTH, pack_tick

__all__ = ["TICK", "TRUTH", "pack_tick"]
