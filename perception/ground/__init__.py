"""The ground plane from the boxes of people: a camera without a calibration."""
