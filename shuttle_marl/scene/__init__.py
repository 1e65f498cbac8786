"""Recorded rallies as scenes for Foxglove and Lichtblick: players, shuttle, score, chances. See ``docs/foxglove.md``.

Needs the extra ``scene``.
"""
