"""Few rows for a path of many, within a tolerance at every time."""
