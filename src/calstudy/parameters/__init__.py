"""Calibrated parameters: names, units, intervals, the box that they span, and what follows from them."""

from calstudy.parameters.space import GRID, Array, Box, Grid, Parameter, Space, constant_of

__all__ = ["GRID", "Array", "Box", "Grid", "Parameter", "Space", "constant_of"]
