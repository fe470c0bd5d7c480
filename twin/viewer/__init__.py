"""Live view of a sensor in a browser: sliders move its parts, and its image is recomputed."""
