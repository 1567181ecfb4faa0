"""Damaged files for every reader: each is read, or refused in the project's words."""
