"""Offsets of the command as splines, and their limits."""
