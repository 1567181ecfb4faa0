"""G-code: reading and writing."""
