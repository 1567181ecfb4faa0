"""Time, axes and place of a record against the simulation."""
