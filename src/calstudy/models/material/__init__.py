"""The material of a shipped test: sizes, cohesion, rolling model, walls and coarse-graining.

A deck as it is shipped has spheres of one size without cohesion, EPSD rolling friction, and walls of the
beads' own elastic constants. Any other material is `[models.material]` in a calibration's file.
"""
