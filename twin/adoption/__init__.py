"""The twin of a real rig, made from its captures: what they say of it, as a rig file."""
