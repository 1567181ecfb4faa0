"""The feed as the unknown: error against time."""
