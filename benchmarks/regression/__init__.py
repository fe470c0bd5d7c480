"""Regression benchmarks: accuracy and speed figures against committed baselines (`all.py`)."""
