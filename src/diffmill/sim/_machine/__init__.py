"""Machines that carry the tool: elastic arm, quasi-static arm, commands."""
