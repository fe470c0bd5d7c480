"""Known properties of a rig's devices: pinholes, their calibration, the camera's noise."""
