"""Many matches in one Gymnasium vector environment: the matches of ``match_v0``, bit for bit."""

from typing import Any

import numpy as np
import pytest

from shuttle_marl.base.errors import ActionError
from shuttle_marl.env.single import SingleMatchEnv
from shuttle_marl.env.vector import MatchVectorEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.kernel import KernelError, MatchBatch
from shuttle_marl.kernel.rally import MatchRows
from tests.exact.exact_games import random_policy, tiring_game

NAME = "shuttle_marl/Match-v0"
SHORT = Rules(points=3, clear=2, cap=5, games=2)
ONE = Rules(points=1, clear=1, cap=1, games=1)
GAME = tiring_game()


@pytest.mark.parametrize(
    ("rules", "first_server", "reward", "seat"),
    [
        (SHORT, None, "match", 0),
        (SHORT, 0, "rally", 1),
        (ONE, None, "rally", 0),
        (ONE, None, "match", 1),
        (Rules(), 1, "match", 1),
    ],
)
def test_rows_play_the_matches_of_the_environment_of_one(reward: str, seat: int, rules: Rules, first_server: int | None) -> None:
    rows, options = 3, {"rules": rules, "reward": reward, "first_server": first_server, "game": GAME}
    opponent = random_policy(GAME, 3)
    vector = MatchVectorEnv(rows, opponent=opponent, seat=seat, **options)  # type: ignore[arg-type]
    alone = [SingleMatchEnv(opponent=opponent, seat=seat, **options) for _ in range(rows)]  # type: ignore[arg-type]
    assert vector.single_observation_space == alone[0].observation_space
    seen, infos = vector.reset(seed=8)
    # In one row of B episodes b, b + B, … are played; those that never come to the learner are passed over in steps of B too.
    expected = [begin(env, b, rows, seed=8) for b, env in enumerate(alone)]
    rng = np.random.default_rng(0)
    over, episodes = np.zeros(rows, bool), 0
    for _ in range(900 if rules == BWF else 150):
        for b, env in enumerate(alone):
            assert seen["observation"][b].tobytes() == expected[b]["observation"].tobytes()
            assert seen["action_mask"][b].tobytes() == expected[b]["action_mask"].tobytes()
            score = env.raw.score_of(seat)
            assert (*infos["points"][b], *infos["games"][b]) == score
        strokes = np.array([rng.choice(np.flatnonzero(mask)) for mask in seen["action_mask"]])
        if rng.random() < 0.02:
            strokes[0] = int(np.flatnonzero(seen["action_mask"][0] == 0)[0])  # not legal
        seen, rewards, over, truncated, infos = vector.step(strokes)
        assert not truncated.any()
        for b, env in enumerate(alone):
            last, paid, ended, _, info = env.step(int(strokes[b]))
            assert (rewards[b], over[b]) == (paid, ended)
            expected[b] = last
            if ended:
                episodes += 1
                assert infos["final_info"]["reason"][b] == info["reason"]
                assert infos["final_obs"][b]["observation"].tobytes() == last["observation"].tobytes()
                assert not infos["final_obs"][b]["action_mask"].any()
                expected[b] = begin(env, rows, rows)
    assert episodes > (2 if rules == BWF else 9)


def begin(env: SingleMatchEnv, ahead: int, rows: int, seed: int | None = None) -> Any:
    """First observation of the learner in the next episode of a row that comes to it."""
    raw, agent = env.raw, env._agent
    if seed is not None:
        raw.reset(seed=seed)
        raw.episode = -1
        ahead += 1
    while True:
        raw.episode += ahead - 1
        raw.reset()
        env._owed = env._await_turn()
        ahead = rows
        if not raw.terminations[agent]:
            env._over = False
            return raw.observe(agent)


def test_batch_and_threads_change_nothing() -> None:
    """Row 0 of one is what all rows of many play in turn."""
    opponent = random_policy(GAME, 3)
    batches = [
        MatchBatch(GAME, 2048, opponents=[opponent], seed=2, rules=SHORT, each_rally=True, threads=threads) for threads in (1, 2)
    ]
    for _ in range(40):
        strokes = [batch.random_strokes() for batch in batches]
        assert np.array_equal(strokes[0], strokes[1])
        found = [batch.step(stroke, reset=False) for batch, stroke in zip(batches, strokes, strict=True)]
        assert np.array_equal(found[0][0], found[1][0])
        assert np.array_equal(found[0][1], found[1][1])
        for batch, (_, over) in zip(batches, found, strict=True):
            batch.reset(rows=over)
    fused = MatchBatch(GAME, 2048, opponents=[opponent], seed=2, rules=SHORT, each_rally=True)
    for _ in range(40):
        fused.step(fused.random_strokes())
    for name in MatchRows._fields:
        first, *others = (np.asarray(getattr(batch.matches, name)) for batch in (*batches, fused))
        assert all(np.array_equal(first, other) for other in others), name
    assert batches[0].unseen == batches[1].unseen


def test_what_cannot_be_asked_for() -> None:
    env = MatchVectorEnv(2)
    env.reset(seed=0)
    with pytest.raises(ActionError, match="expected 2 integers"):
        env.step(np.array([0, default_game().n_strokes]))
    batch = env.versus
    over = batch.rows.live
    over[1] = False
    with pytest.raises(Exception, match="row 1: its rally is over"):
        batch.step(np.zeros(2, np.int64))
    with pytest.raises(KernelError, match="strokes: "):
        batch.step(np.zeros(3, np.int64))
