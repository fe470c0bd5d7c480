"""Models of the devices of a rig: calibrated geometry, projector light and camera noise."""
