"""Programs of robots and of planning systems: KRL, RAPID, APT."""
