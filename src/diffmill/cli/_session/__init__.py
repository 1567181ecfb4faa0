"""A command's session: errors, progress, checkpoints and the settings of JAX."""
