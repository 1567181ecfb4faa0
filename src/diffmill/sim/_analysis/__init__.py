"""Analyses of a run: stability, sensitivity, collisions of tool and holder."""
