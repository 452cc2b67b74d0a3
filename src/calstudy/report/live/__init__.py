"""What is shown of a calibration while somebody looks at it."""
