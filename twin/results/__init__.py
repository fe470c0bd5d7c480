"""Results of a measurement by any method: its record, its scores, and its folder of files."""
