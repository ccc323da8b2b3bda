"""Captures of what passes between host and board: recorded, imported, compared and played back."""
