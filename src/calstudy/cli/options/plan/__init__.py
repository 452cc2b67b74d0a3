"""Options of the commands on the plan."""
