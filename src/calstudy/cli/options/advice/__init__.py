"""Options of ``advise``."""
