"""Tables of a file for `diffmill learn`."""
