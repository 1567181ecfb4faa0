"""What stands between the program and the motors."""
