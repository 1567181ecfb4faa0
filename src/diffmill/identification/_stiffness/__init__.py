"""Joint stiffness from load tests."""
