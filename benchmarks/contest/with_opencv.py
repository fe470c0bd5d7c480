"""Decoding by OpenCV's contributed module `structured_light`: Gray code."""

from collections.abc import Callable

import cv2
import numpy as np

from benchmarks.contest.child import Arrays


def decode(inputs: Arrays) -> Callable[[], Arrays]:
    """Decode pixel by pixel: in Python, `decode` gives the disparity of two cameras only."""
    cv2.setNumThreads(1)
    peer = cv2.structured_light.GrayCodePattern_create(1280, 720)
    images = list(inputs["gray"])[: peer.getNumberOfPatternImages()]
    rows, cols = images[0].shape

    def action() -> Arrays:
        decoded_px = np.full((rows, cols, 2), np.nan)
        for row in range(rows):
            for col in range(cols):
                wrong, projector_px = peer.getProjPixel(images, col, row)
                if not wrong:
                    decoded_px[row, col] = projector_px
        return {"px": decoded_px}

    return action
