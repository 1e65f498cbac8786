"""Validation of the game: its predictions compared with unseen matches.

The game is solved exactly, so errors of its values are errors of its models. Each figure compares the game with matches that were
not used to fit it:

- :mod:`experiments.truth.decisions`: are the advantages of chosen strokes realised in the outcomes of rallies?
- :mod:`experiments.truth.likeness`: can a classifier distinguish simulated rallies from real ones, and by which features?
- :mod:`experiments.truth.recovery`: do the effects of positions hold?
- :func:`experiments.truth.worlds.transfer`: does the advantage of a policy hold in a game fitted on other matches?

``python -m experiments.truth --help`` prints the options.
"""
