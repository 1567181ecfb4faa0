"""From checked tables to the parts of a job: program, stock, robot."""
