"""The open benchmark: any calibrator on the same emulated DEM models, paid by the run."""
