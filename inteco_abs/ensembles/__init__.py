"""Many virtual rigs at once: the rig's physics compiled, on arrays. Needs the extra `lab`."""

from inteco_abs.ensembles.batch import BatchPlant

__all__ = ["BatchPlant"]
