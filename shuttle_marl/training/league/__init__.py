"""Training of a league: main agents and exploiters learn from each other, earlier policies and exact best responses.

See ``docs/league_training.md``. Modules: settings (``config``), state and payoffs (``population``), the turns of a round
(``schedule``), a turn of one learner (``turns``), and the run (``run``).
"""
