"""Exact scores equal simulation through the Gymnasium environment, for methods of every task of players and logs."""

from pathlib import Path
from typing import Final

import numpy as np
import pytest

from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.exact import best_response
from shuttle_marl.exact.odds import pair_odds
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.suite import results
from shuttle_marl.suite.adapt import CHANGES
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.offline import OPPONENT, targets
from shuttle_marl.suite.population import ADAPT_RALLIES, opponent
from shuttle_marl.suite.results import TASKS, arena_of
from shuttle_marl.suite.task import Outcome
from tests.reduced import reduced_model
from tests.suite.small import run

ROWS, EPISODES = 1000, 10
METHODS: Final = {
    "exploit-v1": ("minimax", "ppo-self-play", "model-boosted"),
    "equilibrium-v1": ("minimax", "minimax-deterministic", "model-boosted"),
    "adapt-v1": ("counts", "posterior-mean", "mixture"),
    "offline-v1": ("clone", "fitted-q", "model-pessimistic"),
    "evaluate-v1": ("weighted-importance-sampling", "dice", "fitted-q-evaluation"),
}


def simulated(player: TabulatedPolicy, against: TabulatedPolicy, seed: int) -> tuple[float, float]:
    """Rallies won of 100, played through the environment, and their standard error."""
    game, rng = player.game, np.random.default_rng(seed)
    env = RallyVectorEnv(ROWS, opponent=against, game=game, mask="none", info="none")
    _, infos = env.reset(seed=seed)
    first = np.zeros(game.n_states, dtype=np.int64)
    first[game.playable] = game.pair_start[:-1][game.playable]
    played, won, unseen = np.zeros(ROWS, dtype=int), 0.0, np.zeros((ROWS, 2))
    while (played < EPISODES).any():
        counting = played < EPISODES
        # Rallies that ended before the learner's first choice; those after the last counted one do not count.
        unseen[counting] = infos["unseen"][counting]
        state, draw = env.versus.rows.state, rng.integers(CHOICE_ONE, size=(2, ROWS))
        strokes = game.pair_stroke[first[state] + player.choose(state, draw[0])]
        if game.hides:
            strokes = np.where(env.versus.waits, game.n_strokes + player.choose_position(state, draw[1]), strokes)
        _, rewards, over, _, infos = env.step(strokes)
        won += (rewards[over & counting] > 0).sum()
        played[over & counting] += 1
    number = ROWS * EPISODES + unseen.sum()
    mean = float((won + unseen[:, 0].sum()) / number)
    return 100 * mean, float(100 * (mean * (1 - mean) / number) ** 0.5)


def unit(task: str, method: str, folder: Path) -> tuple[dict[str, float], Outcome]:
    """Scores and outcome of the first case of a quick run."""
    played = run(task, method, folder / "run")
    entry = results.read_entry(results.entry_path(played, 0, 0))
    return dict(entry.scores), results.read_outcome(played, entry, arena_of(TASKS[task], reduced_model(), "dev", quick=True).game)


@pytest.mark.parametrize(
    ("task", "method"),
    [
        pytest.param(task, method, marks=pytest.mark.slow if place else ())
        for task, methods in METHODS.items()
        for place, method in enumerate(methods)
    ],
)
def test_scores_equal_simulation(task: str, method: str, tmp_path: Path) -> None:
    arena = arena_of(TASKS[task], reduced_model(), "dev", quick=True)
    case, (scores, outcome) = TASKS[task].cases(arena)[0], unit(task, method, tmp_path)
    if task == "evaluate-v1":
        # The bias is the mean estimate less the mean value of the policies, of which the environment knows some.
        policies = list(targets(arena, case, 0).values())
        values = [100 * odds.rally for odds in pair_odds([(policy, arena.policy(OPPONENT)) for policy in policies])]
        assert scores["bias"] == pytest.approx(np.mean(100 * np.array(outcome.answers["estimates"]) - values), abs=1e-6)
        for number in range(METHODS[task].index(method), len(policies), 2 * len(METHODS[task])):
            mean, error = simulated(policies[number], arena.policy(OPPONENT), number)
            assert mean == pytest.approx(values[number], abs=4 * error)
        return
    if task == "adapt-v1":
        (against,) = opponent(arena, case.options["family"], case.options["number"]).policies
        shares = np.diff([*CHANGES, ADAPT_RALLIES]) / ADAPT_RALLIES
        parts = [simulated(outcome.policies[str(start)], against, start) for start in CHANGES]
        won = float(shares @ [mean for mean, _ in parts])
        error = float(np.sqrt(shares**2 @ [each**2 for _, each in parts]))
        best = 100 * best_response(against).value.odds().rally
        assert best - won == pytest.approx(scores["regret"], abs=4 * error + 0.02)
        return
    player = outcome.policies["player"]
    against = {
        "exploit-v1": lambda: opponent_of(arena, case),
        "equilibrium-v1": lambda: arena.policy("bc"),
        "offline-v1": lambda: arena.policy(OPPONENT),
    }[task]()
    won, error = simulated(player, against, 0)
    if task == "exploit-v1":
        perfect, more = simulated(arena.policy("minimax"), against, 1)
        assert won - perfect == pytest.approx(scores["score"], abs=4 * float(np.hypot(error, more)))
    else:
        assert won - 50 == pytest.approx(scores["won" if task == "equilibrium-v1" else "score"], abs=4 * error)
    lost, error = simulated(best_response(player).policy, player, 2)
    assert lost - 50 == pytest.approx(scores["exploitability"], abs=4 * error)
