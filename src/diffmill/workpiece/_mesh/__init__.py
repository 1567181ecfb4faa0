"""Meshes of a stock, into it and out of it."""
