"""Studies: what was measured, and the fit of all of it with its checks."""
