"""The controller between the program and the motors."""
