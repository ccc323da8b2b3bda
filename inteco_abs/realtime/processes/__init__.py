"""The processes of a real-time run, one module each."""
