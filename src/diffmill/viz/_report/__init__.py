"""The report, and all figures of a result as files."""
