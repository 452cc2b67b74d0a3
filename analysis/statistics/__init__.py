"""Estimates with intervals, linear models, MANOVA and verdicts, on arrays and frames alone."""
