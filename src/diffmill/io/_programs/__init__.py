"""Programs for machines and robots: reading and writing."""
