"""A match in which every server loses the rally."""

SCORES = [
    (0, 0, 0, 0),
    (0, 1, 0, 0),
    (1, 1, 0, 0),
    (0, 0, 0, 1),
    (1, 0, 0, 1),
    (1, 1, 0, 1),
    (0, 0, 1, 1),
    (0, 1, 1, 1),
    (1, 1, 1, 1),
]
"""Points and games of both seats before each of nine rallies; seat 0 serves first."""
