"""The simulated cut whose forces are linear in the coefficients."""
