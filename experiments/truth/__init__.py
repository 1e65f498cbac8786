"""Is the game true? Its promises beside what happened in real matches.

The game is solved exactly, so all that can be wrong with its values is wrong with its models. Each figure here compares the
game with matches that took no part in fitting it:

- :mod:`experiments.truth.decisions`: do chosen strokes bring what their exact values promise?
- :mod:`experiments.truth.likeness`: can simulated rallies be told apart from real ones, and by what?
- :mod:`experiments.truth.limits`: what keeps promises from coming true?
- :mod:`experiments.truth.transfer`: does an advantage survive in a game fitted on other matches?

``python -m experiments.truth --help`` says how to run them.
"""
