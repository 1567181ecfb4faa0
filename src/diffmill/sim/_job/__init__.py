"""The simulation of a job: from its settings to a solution."""
