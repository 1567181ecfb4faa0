"""Methods of correction, and plants that they run on."""
