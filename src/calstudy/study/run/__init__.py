"""What commands and calls from Python assemble and run: calibrations into their study directory."""
