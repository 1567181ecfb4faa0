"""Checks of a whole job: reach, rapids, holder and the robot's modes."""
