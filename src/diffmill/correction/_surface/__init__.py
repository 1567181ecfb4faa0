"""The machined surface as the objective, and bounds on it."""
