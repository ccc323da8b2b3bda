"""The vendor's identification procedure as software."""
