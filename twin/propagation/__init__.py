"""Uncertainty of any figure of a measurement: trials, intervals, ranked budget, sensitivities.

The trials are cases of a study (`twin.study.trials`): its store, workers, resume and cluster. Here
their results become distributions (JCGM 101, propagation of distributions) and budgets (JCGM 100).
"""
