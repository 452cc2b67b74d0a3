"""Options of each command, apart from the command itself, so that its help loads no library."""
