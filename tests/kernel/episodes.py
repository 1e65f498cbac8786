"""Rallies played once more by the environment, stroke by stroke."""

import numpy as np
import numpy.typing as npt

from shuttle_marl.env import rally_v0
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.tables import Game

Ints = npt.NDArray[np.integer]


def compare_with_rally_v0(
    seed: int,
    rally: Ints,
    *,
    server: Ints,
    winner: Ints,
    reason: Ints,
    length: Ints,
    stroke: Ints,
    serves: int | None = None,
    game: Game | None = None,
) -> None:
    """Assert that rallies have the server, the end, the winner and the length of the same episodes of ``rally_v0``."""
    raw = rally_v0.raw_env(server=serves, game=game)
    rows = {number: row for row, number in enumerate(rally.tolist())}
    assert len(rows) == len(rally)
    end = np.cumsum(length)
    for number in range(max(rows) + 1):
        raw.reset(seed=seed if number == 0 else None)
        if number not in rows:
            continue
        row = rows[number]
        assert raw.agent_selection == f"player_{server[row]}"
        for action in stroke[end[row] - length[row] : end[row]].tolist():
            assert not any(raw.terminations.values())
            raw.step(action)
        assert all(raw.terminations.values())
        assert raw.rewards[f"player_{winner[row]}"] == 1
        assert raw.infos["player_0"]["outcome"] == OUTCOMES[reason[row]]
