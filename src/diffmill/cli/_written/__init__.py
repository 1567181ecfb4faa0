"""Files of a run beside its results: corrected programs, the machined surface."""
