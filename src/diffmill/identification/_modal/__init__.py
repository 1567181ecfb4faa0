"""Modes and damping from a ring-down or a frequency response."""
