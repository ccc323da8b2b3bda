"""The computer: what it grants a real-time process, which boards it has, and what to change."""
