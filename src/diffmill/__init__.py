"""diffmill."""
