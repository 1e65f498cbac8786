"""Duels and ratings by the quality of decisions, simulated (:mod:`shuttle_marl.reports.rating`).

``python -m experiments.play [--json]``

In simulated duels of the live court a better decider meets a worse one. Both choose as elite players do, but for the odds of
strokes that are marked ``?!``, ``?`` or ``??``: the share of judged strokes without such a mark is given. Players with known
policies are rated by their first judged decisions. Opponents of the ladder are listed with their exact probability of winning a
rally against the average pro.
"""

import sys
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro

from experiments.saving import show_figures
from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import Json
from shuttle_marl.exact import evaluate, visits
from shuttle_marl.game.draws import stream
from shuttle_marl.game.rally.record import Rallies
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities, tabulate
from shuttle_marl.kernel import Matches, play_matches
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports.rating import Rating, rater_of
from shuttle_marl.watch.plan import DUEL, LADDER

ACCURACY: Final = (0.9, 0.7)
RATED: Final = ("random", "bc", "human:0.05", "minimax")
"""Policies whose ratings are compared, the weakest decider first."""
DECISIONS: Final = 30
_ENOUGH: Final = 4
"""Duels of a player in which there are surely as many judged decisions."""
_STEPS: Final = 40


class Judge:
    """``[P]`` quality of the legal pairs of a game, NaN: not judged, and whether each is marked as a mistake."""

    def __init__(self, game: Game) -> None:
        states = np.flatnonzero(game.playable)
        judged = rater_of(game).rated(states)
        _, pairs = game.pairs(states)
        self.game, self.bad = game, np.zeros(game.n_pairs, np.bool_)
        self.quality: F64 = np.full(game.n_pairs, np.nan)
        self.quality[pairs], self.bad[pairs] = judged.quality, ["?" in mark for mark in judged.marks]

    def decider(self, accuracy: float) -> TabulatedPolicy:
        """The average pro with other odds of mistakes, so that the accuracy in the states of two average pros is as given."""
        game, usual = self.game, tabulate(resolve("bc", self.game), self.game)
        p, known = usual.pair_probabilities(), ~np.isnan(self.quality)
        seen = game.of_pairs(visits(usual, usual).states[0])

        def tilted(log_odds: float) -> F64:
            weight = p * np.exp(log_odds * self.bad)
            return np.asarray(weight / np.maximum(game.of_pairs(game.sum_by_state(weight)), 1e-12))

        low, high = -10.0, 10.0
        for _ in range(_STEPS):
            middle = (low + high) / 2
            played = seen * tilted(middle) * known
            low, high = (middle, high) if 1 - played[self.bad].sum() / played.sum() > accuracy else (low, middle)
        return from_pair_probabilities(game, tilted(low))

    def decisions(self, rallies: Rallies) -> tuple[F64, Bools]:
        """``[N]`` quality of every stroke, and whether it is a mistake."""
        pair = self.game.pair(rallies.states(self.game), rallies.stroke.astype(np.int64))
        return self.quality[pair], self.bad[pair]


def duels(game: Game, policies: list[TabulatedPolicy], number: int, points: int, seed: int) -> tuple[Any, Rallies]:
    """Games won by both seats of duels between two policies, who serve first in turn, and their rallies."""
    key, first = stream(seed, np.full(number, points, np.uint64), np.arange(number)), (np.arange(number) % 2).astype(np.int8)
    matches = Matches(entrant=np.tile(np.array([0, 1], np.int32), (number, 1)), first_server=first, key=key)
    played = play_matches(game, matches, policies, rules=Rules(points=points, clear=1, cap=points, games=1))
    return played.games, played.rallies


def compared(judge: Judge, number: int, seed: int) -> dict[str, Any]:
    """How often the better decider is ahead, by decisions and by rallies, in duels of several lengths."""
    policies, found = [judge.decider(accuracy) for accuracy in ACCURACY], {}
    for points in (3, DUEL):
        games, rallies = duels(judge.game, policies, number, points, seed)
        score, bad = judge.decisions(rallies)
        known, match = ~np.isnan(score), rallies.match[rallies.row_of_stroke].astype(np.int64)
        cell = 2 * match + rallies.striker
        count, total, mistakes = (np.bincount(cell[known], w, 2 * number) for w in (None, score[known], bad[known]))
        mean = (total / np.maximum(1, count)).reshape(-1, 2)
        found[str(points)] = {
            "ahead_by_decisions": float((mean[:, 0] > mean[:, 1]).mean()),
            "ahead_by_rallies": float((games[:, 0] > games[:, 1]).mean()),
            "accuracy": [float(1 - mistakes[seat::2].sum() / count[seat::2].sum()) for seat in (0, 1)],
            "quality": [float(total[seat::2].sum() / count[seat::2].sum()) for seat in (0, 1)],
            "judged_decisions": float(count.mean()),
        }
    return found


def ratings(judge: Judge, number: int, seed: int) -> dict[str, Any]:
    """Ratings of players with known policies after their first judged decisions against the average pro."""
    opponent, found, all_points = tabulate(resolve("bc", judge.game), judge.game), {}, []
    for name in RATED:
        policies = [tabulate(resolve(name, judge.game), judge.game), opponent]
        _, rallies = duels(judge.game, policies, number * _ENOUGH, DUEL, seed)
        score, _ = judge.decisions(rallies)
        mine = (rallies.striker == 0) & ~np.isnan(score)
        player = rallies.match[rallies.row_of_stroke][mine].astype(np.int64) // _ENOUGH
        order = np.argsort(player, kind="stable")
        scores = np.split(score[mine][order], np.cumsum(np.bincount(player, minlength=number))[:-1])
        after = [Rating().after(one[:DECISIONS].tolist()) for one in scores if len(one) >= DECISIONS]
        points = np.array([rating.points for rating in after])
        low, high = np.quantile(points, (0.025, 0.975))
        all_points.append(points)
        found[name] = {
            "points": float(points.mean()),
            "low": float(low),
            "high": float(high),
            "deviation": float(np.mean([rating.deviation for rating in after])),
            "players": len(points),
        }
    for name, weaker, stronger in zip(RATED[1:], all_points, all_points[1:], strict=False):
        found[name]["above_the_one_before"] = float((stronger[:, None] > weaker).mean())
    return found


def ladder(game: Game) -> dict[str, float]:
    """Probability of every opponent of the ladder to win a rally against the average pro."""
    usual = tabulate(resolve("bc", game), game)
    return {name: float(evaluate(tabulate(resolve(name, game), game), usual).odds().rally) for name in LADDER}


def play(
    *,
    duels: Annotated[int, tyro.conf.arg(name="duels")] = 1000,
    seed: int = 0,
    model: str = "default",
    out: Path | None = None,
    json_output: Json = False,
) -> None:
    """Simulate duels and ratings of the live court.

    Args:
        duels: simulated duels of each length, and players of each policy.
        seed: random seed.
        model: a model by name or folder.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    game = load_game(model)
    judge = Judge(game)
    result = {"duels": compared(judge, duels, seed), "ratings": ratings(judge, duels, seed), "ladder": ladder(game)}
    show_figures(result, out, as_json=json_output, seed=seed, number=duels)


main = cli.entry_point(play, "python -m experiments.play", __doc__ or "")

if __name__ == "__main__":
    sys.exit(main())
