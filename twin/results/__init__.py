"""One record of a measurement by any method: its types, its scores, and its folder."""
