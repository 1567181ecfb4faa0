"""The run as a linear system."""
