"""Independent references in NumPy, for tests and experiments.

Nothing here imports diffmill: no dexels, no JAX, no code in common with what is
verified. `marching` integrates cutting forces of general end mills in time;
`halfspaces` describes the raw stock that they cut.
"""
