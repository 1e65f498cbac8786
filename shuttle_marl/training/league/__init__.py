"""Training of a league: main agents and exploiters that learn from each other, from the past and from exact best responses.

See ``docs/league_training.md``. The modules: settings (:mod:`~shuttle_marl.training.league.config`), whom a learner meets
(:mod:`~shuttle_marl.training.league.matchmaking`), the policies so far and what they win against each other
(:mod:`~shuttle_marl.training.league.population`), a turn of one learner (:mod:`~shuttle_marl.training.league.turns`), mixtures of
policies (:mod:`~shuttle_marl.training.league.mixtures`), and the run (:mod:`~shuttle_marl.training.league.run`).
"""
