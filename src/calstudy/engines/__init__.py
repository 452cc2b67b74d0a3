"""How a DEM program is run: parameters and a seed go in, one run's record comes out."""
