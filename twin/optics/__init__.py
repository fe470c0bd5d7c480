"""Mitsuba scenes and the one-trace renderer; no other package of `twin` imports Mitsuba."""
