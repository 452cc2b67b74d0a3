"""Calibrations assembled and run into their study directory, for commands and from Python."""
