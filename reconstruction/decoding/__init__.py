"""From camera frames to projector coordinates, their sigma, and why a pixel has none."""
