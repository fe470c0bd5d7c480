"""Estimate unknown fields of a sensor from measurements made with it, by Bayes' theorem."""
