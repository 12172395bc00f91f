"""The running system: operators, calibration, the 50 Hz loop, safety, recording."""
