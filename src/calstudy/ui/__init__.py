"""The calibration in the browser: a page over the file, the study and the commands."""
