"""The tables of a campaign, and the values that it draws."""
