"""Options of the command of the page."""
