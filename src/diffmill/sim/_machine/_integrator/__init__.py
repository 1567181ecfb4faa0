"""Integrators of the arm within a tooth period."""
