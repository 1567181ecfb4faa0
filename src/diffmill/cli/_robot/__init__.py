"""Report of a robot: masses, stiffness, modes, sag, figures."""
