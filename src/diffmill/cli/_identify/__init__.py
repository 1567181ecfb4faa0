"""The command `identify`: what it prints and draws for each kind of study."""
