"""From projector coordinates to points in the world frame, mm, with their sigma."""
