"""Mitsuba scenes and the one-trace renderer; the only place that imports Mitsuba."""
