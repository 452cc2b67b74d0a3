"""What is simulated, and what is measured of it."""
