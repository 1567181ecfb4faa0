"""Records: preparation, cuts, spindle angle, and what is wrong with them."""
