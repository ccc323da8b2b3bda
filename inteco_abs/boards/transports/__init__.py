"""Who carries the bytes or register accesses between host and board."""
