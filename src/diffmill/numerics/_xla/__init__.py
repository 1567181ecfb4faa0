"""Hints to XLA and JAX: they change times and memory, and no result."""
