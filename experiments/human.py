"""Strength and similarity to human play of the KL-regularised policies ``human:TAU``, and TAU fitted to single players.

    python -m experiments.human --data DATA [--split validation] [--json]

With TAU, ``human:TAU`` moves from perfect play to the average player ``bc`` (:func:`shuttle_marl.exact.solve_soft`). For each
TAU: the fraction of rallies won against ``bc``, in the game and in its refits, and the cross-entropy on real strokes of unseen
matches, in nats per stroke. Then TAU is fitted for each player with a clone: the one under which ``human:TAU:PLAYER`` gives their
strokes the highest likelihood, infinity being the clone itself. A low TAU says that among their usual strokes a player prefers
those with a higher value in the game.

The target of a fault is unknown: faults are scored by shot type and technique, other strokes by the area too.
"""

import dataclasses
import functools
import math
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.progress import track

from docs.tools.results import show
from experiments.truth.matches import RESAMPLES, Strokes, of_splits, ratio_by_match, states_of, strokes_of
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import Outcome, Split, read_matches
from shuttle_marl.dynamics.features import Rows, load_hurry
from shuttle_marl.exact import PairPolicy, solve_soft
from shuttle_marl.exact.odds import of_pair, over
from shuttle_marl.game import load_game
from shuttle_marl.game.policy import from_pair_probabilities
from shuttle_marl.game.shipped import model_folder, refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import Scorer, baselines

TAUS: Final = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.3, 0.5, 1.0, 2.0)  # values of TAU, in addition to infinity
LEAST_STROKES: Final = 200  # minimum number of strokes of a player in the split
_TOLERANCE: Final = 1e-7


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Answers:
    """Legal pairs that each of N real strokes can have been."""

    rows: Rows  # strokes with at least one, and `[N]` their `rally`
    rally: I64
    row: I64  # [M] stroke that a pair belongs to
    pair: I64  # [M] the pair: one for a stroke with a known target, else one for each target

    def losses(self, probability: F64) -> F64:
        """``[N]`` minus log-likelihood of each stroke under the ``[P]`` or ``[base pairs]`` probabilities of a policy."""
        return np.asarray(-np.log(np.bincount(self.row, probability[self.pair % len(probability)], len(self.rows))))

    def of(self, which: Bools) -> "Answers":
        """Selection of strokes."""
        kept = which[self.row]
        row = (np.cumsum(which) - 1)[self.row[kept]]
        return Answers(rows=self.rows.take(which), rally=self.rally[which], row=row, pair=self.pair[kept])


def answers(game: Game, strokes: Strokes) -> Answers:
    """The legal pairs of real strokes; strokes that are not in the game are dropped."""
    codes, state = strokes.rows.game_codes, states_of(game, strokes.rows)
    known = np.flatnonzero(state >= 0)
    at, pair = game.pairs(state[known])
    row, played = known[at], game.base_pair_stroke[pair % game.n_base_pairs]
    aimed = (strokes.rows.outcome != Outcome.FAULT) & (codes["area"] >= 0)
    alike = ~aimed[row] | (game.catalogue.area[played] == codes["area"][row])
    for part in ("shot", "technique"):
        alike &= getattr(game.catalogue, part)[played] == codes[part][row]
    found = np.zeros(len(strokes), dtype=bool)
    found[row[alike]] = True
    return Answers(rows=strokes.rows, rally=strokes.rally, row=row[alike], pair=pair[alike]).of(found)


def curve(game: Game, real: Answers, console: Console) -> list[dict[str, Any]]:
    """Strength and likeness of ``human:TAU`` for every TAU; None is infinity (``bc``)."""
    prior = PairPolicy(game=game, probability=baselines.probabilities(None, game))
    scorer, refits = Scorer(game), refits_of(game)
    found: list[dict[str, Any]] = []
    for tau in track([*TAUS, math.inf], "strength and likeness", console=console, transient=True):
        policy = prior if tau == math.inf else solve_soft(prior, tau=tau, tolerance=_TOLERANCE).policy[0]
        table = from_pair_probabilities(game, policy.pair_probabilities())
        home = scorer.score_table(table, f"human:{tau}").home
        away = over(refits, functools.partial(of_pair, table, scorer.reference)) if refits else None
        likeness = ratio_by_match(real.losses(policy.probability), np.ones(len(real.rows)), real.rows.match)
        found.append(
            {
                "tau": _finite(tau),
                "cross_entropy": likeness,
                "home": home,
                "away": None if away is None else {"rally_win_vs_bc": away["rally_win"].as_json()},
            }
        )
    return found


def fitted_players(game: Game, real: Answers, console: Console) -> list[dict[str, Any]]:
    """TAU of every player with a clone and enough strokes, most strokes first."""
    average = PairPolicy(game=game, probability=baselines.probabilities(None, game))
    names, counts = np.unique(real.rows.striker, return_counts=True)
    chosen = [str(names[i]) for i in np.argsort(-counts, kind="stable") if counts[i] >= LEAST_STROKES]
    found = []
    for player in track([name for name in chosen if name in baselines.players(game)], "players", console=console, transient=True):
        mine = real.of(real.rows.striker == player)
        own = PairPolicy(game=game, probability=baselines.probabilities(player, game))
        policies = [solve_soft(own, average, tau=tau, tolerance=_TOLERANCE).policy[0].probability for tau in TAUS]
        losses = np.stack([mine.losses(probability) for probability in (*policies, own.probability)])
        found.append({"player": player, "matches": len(np.unique(mine.rows.match)), **fit(losses, mine.rally)})
    return found


def fit(losses: F64, rally: I64, seed: int = 0) -> dict[str, Any]:
    """The TAU of highest likelihood, with 95 % intervals by a bootstrap over rallies.

    Args:
        losses: ``[TAUS and infinity, N]`` minus log-likelihood of each stroke.
        rally: ``[N]`` rally of each stroke.
        seed: of the resamples.

    Returns:
        ``strokes``, ``tau`` (None for infinity), ``low``, ``high``, ``cross_entropy`` of the clone, and ``gain``: nats a stroke
        that the fitted TAU gains on the clone.
    """
    names, index = np.unique(rally, return_inverse=True)
    sums = np.stack([np.bincount(index, loss, len(names)) for loss in losses], axis=1)
    counts = np.bincount(index, minlength=len(names))
    drawn = np.random.default_rng(seed).integers(0, len(names), (RESAMPLES, len(names)))
    totals = sums[drawn].sum(axis=1)
    best = int(sums.sum(axis=0).argmin())
    taus = np.array([*TAUS, math.inf])
    low, high = np.quantile(taus[totals.argmin(axis=1)], [0.025, 0.975], method="nearest")
    gains = (totals[:, -1] - totals[:, best]) / counts[drawn].sum(axis=1)
    return {
        "strokes": losses.shape[1],
        "tau": _finite(taus[best]),
        "low": _finite(low),
        "high": _finite(high),
        "cross_entropy": float(losses[-1].mean()),
        "gain": {
            "value": float((losses[-1] - losses[best]).mean()),
            "low": float(np.quantile(gains, 0.025)),
            "high": float(np.quantile(gains, 0.975)),
        },
    }


def _finite(tau: float) -> float | None:
    return None if math.isinf(tau) else float(tau)


def human(data: Path, split: Split = "validation", model: str = "default", json: bool = False) -> None:
    """Measure strength against likeness, and fit TAU for single players.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches whose strokes are predicted.
        model: a shipped model or a model folder.
        json: print JSON.
    """
    strokes = of_splits(strokes_of(read_matches(data)).marked(load_hurry(model_folder(model))), split)
    game, console = load_game(model), Console(stderr=True)
    real = answers(game, strokes)
    about = {
        "split": split,
        "game": game.hash,
        "matches": len(strokes.matches),
        "strokes": len(strokes),
        "known": len(real.rows),
    }
    result = {**about, "curve": curve(game, real, console), "players": fitted_players(game, real, console)}
    show(result, "human", "human_players", as_json=json)


main = entry_point(human, "python -m experiments.human", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
