"""Sessions as a research object: a folder that a repository takes, and that is read without this program."""

from inteco_abs.analysis.publication.folder import Publication, publish

__all__ = ["Publication", "publish"]
