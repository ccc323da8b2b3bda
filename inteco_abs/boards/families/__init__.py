"""The board families, one folder each."""
