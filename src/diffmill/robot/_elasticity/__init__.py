"""Springs: compliance, modes, receptance, stiffness over the workspace."""
