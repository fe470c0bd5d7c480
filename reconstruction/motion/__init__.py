"""Scenes in motion: phase errors by motion, motion in the frames, and motion by a stage.

| module | content |
|---|---|
| phase_rate | phase error of a sequence by motion; phase rate of each pixel from its frames |
| neighbourhood | phase rate of each pixel from the frames of its neighbours too |
| prediction | error of each point by motion, from a stated motion or from the frames |
| positions | positions of a stage, table [stage] of capture.toml |
| stage | frames of a specimen that a stage moves, corrected by its positions |

Time is in frames: the frames of a capture follow each other at equal intervals. A phase rate e is
the change of a pixel's phase from one frame to the next, rad. Sequences that cancel the error are
those of `stepping`.
"""
