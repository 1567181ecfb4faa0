"""Coefficients, springs and dampers at once, from one record of a robot that cuts."""
