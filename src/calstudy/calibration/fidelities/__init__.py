"""Two fidelities in one calibration: cheap runs give the shape of a response, expensive ones its offset."""
