"""What is known about the devices of a rig: pinholes, their calibration, the camera's noise."""
