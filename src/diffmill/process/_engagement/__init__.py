"""Engagement of the edges: which samples are in the material, and with what chip."""
