"""A study directory on disk: settings and tables, journals, its lock, and who works on it."""
