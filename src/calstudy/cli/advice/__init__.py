"""The command ``advise``."""
