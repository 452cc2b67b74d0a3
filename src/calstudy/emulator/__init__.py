"""Emulators: they answer in place of a DEM program, and let a study be replicated."""
