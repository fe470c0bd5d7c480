"""See a sensor live: move its parts in a browser, and the camera's image follows."""
