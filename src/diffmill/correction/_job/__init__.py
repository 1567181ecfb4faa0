"""The correction of a job: plants, objective, limits, cases, one after another."""
