"""The problem, its objective, and how errors are measured over the path."""
