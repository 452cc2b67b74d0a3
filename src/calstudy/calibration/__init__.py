"""The calibration procedure of Rackl & Hanley (2017); it knows no DEM program."""
