"""Files in the layouts of other programs, written for tests and benchmarks."""
