"""Rigid-body dynamics: mass matrix, inverse and forward dynamics, derivatives."""
