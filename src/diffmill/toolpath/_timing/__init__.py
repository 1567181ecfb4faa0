"""When the tool is where: pieces of a program, speeds on them, rows at instants."""
