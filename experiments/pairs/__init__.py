"""Validation of the game of a pair: players with their skill, compared with matches that were not used to fit it.

- :mod:`experiments.pairs.parts`: models fitted without some matches, with those matches.
- :mod:`experiments.pairs.strokes`: log-loss of faults, returns and contacts with and without the players' offsets.
- :mod:`experiments.pairs.results`: log-loss of results of rallies, compared with ratings.

``python -m experiments.pairs --help`` prints the options.
"""
