"""Data sets: labelled captures of drawn experiments, in the formats of learning programs."""
