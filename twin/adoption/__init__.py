"""Make the twin of a real rig: a rig file with the values that its captures determine."""
