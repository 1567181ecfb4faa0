"""Spatial vectors and rotations."""
