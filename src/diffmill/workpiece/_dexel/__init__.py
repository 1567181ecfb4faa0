"""The tri-dexel stock: rays, removal, occupancy, contact."""
