"""Transports: links for messages, and register access."""
