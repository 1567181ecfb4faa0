"""Cutting coefficients from mean forces or whole records."""
