"""Join overlapping measurements of one large part: register them, and fuse one height map.

A patch is one measurement in the frame of the sensor. `elements` describes its surface by small
quadratic elements, `registration` estimates the poses of all patches together, and `fusion`
averages the moved points in the cells of one grid.
"""
