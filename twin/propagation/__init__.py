"""Uncertainty of any figure of a measurement: trials, intervals, ranked budget, sensitivities.

The trials are the cases of a study (`twin.study.trials`), which runs and stores them. This package
evaluates their results: distributions (JCGM 101, propagation of distributions) and budgets (JCGM
100).
"""
