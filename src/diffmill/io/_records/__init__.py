"""Measured records: text and binary files, channels and time."""
