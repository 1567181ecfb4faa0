"""Robots from files: URDF and TOML, each fault named."""
