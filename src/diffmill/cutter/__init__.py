"""cutter."""
