"""Compares rallies with the same episodes of ``rally_v0``, stroke by stroke; and a network without learning."""

from collections.abc import Callable

import numpy as np

from shuttle_marl.env import rally_v0
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.tables import Game
from tests.reduced import reduced_game

Assess = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def network(seed: int) -> Assess:
    """Logits and values that are fixed numbers for each state of the small game."""
    game, rng = reduced_game(), np.random.default_rng(seed)
    logits = rng.normal(scale=1.5, size=(509, game.n_strokes)).astype(np.float32)
    value = rng.uniform(-0.9, 0.9, size=game.n_states).astype(np.float32)
    return lambda states: (logits[states % 509], value[states])


def compare_with_rally_v0(seed: int, rallies: Rallies, *, game: Game) -> None:
    """Assert that rallies have server, strokes, ending and winner of the episodes of ``rally_v0`` of their ``match`` number."""
    raw = rally_v0.raw_env(game=game)
    rows = {number: row for row, number in enumerate(rallies.match.tolist())}
    assert len(rows) == len(rallies)
    for number in range(max(rows) + 1):
        raw.reset(seed=seed if number == 0 else None)
        if number not in rows:
            continue
        rally = rallies.row(rows[number], game.catalogue)
        assert raw.agent_selection == f"player_{rally.server}"
        for action in rally.stroke.tolist():
            assert not any(raw.terminations.values())
            raw.step(action)
        assert all(raw.terminations.values())
        assert rally.winner == rallies.winner[rows[number]]
        assert raw.rewards[f"player_{rally.winner}"] == 1
        assert raw.infos["player_0"]["outcome"] == OUTCOMES[rally.ending]
