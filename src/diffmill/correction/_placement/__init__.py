"""The place of the workpiece in the cell."""
