"""Checks of a user's model before its first sample: its script, and two trial runs."""
