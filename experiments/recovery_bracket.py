"""What hiding the position is worth, and how far real positions are hidden.

    python -m experiments.recovery_bracket [--data DATA] [--out FILE] [--json]

**The bracket.** In `default:recovery` the striker does not know where the receiver waits. Here the game is also solved for a
striker who does (:class:`Seen`): the receiver chooses a position, the striker sees it and strikes. Real ones are partly seen.

**The evidence** needs matches: whether strokes are aimed away from the receiver, and what the effects of positions are worth in
each discipline (:mod:`experiments.truth.recovery`).
"""

import sys
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro

from docs.tools.results import show
from experiments.truth.matches import in_splits, strokes_of
from experiments.truth.recovery import Judged, aims, by_discipline, cross_judged, judged_by
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.runs import describe
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import read_matches
from shuttle_marl.dynamics.features import Rows, load_hurry
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import EnsembleConfig, softmax, unseen
from shuttle_marl.dynamics.recovery import load_recovery
from shuttle_marl.exact import solve, visits
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.met import met
from shuttle_marl.exact.optimal import pure_policy
from shuttle_marl.exact.profile import block_chances, positions_of
from shuttle_marl.exact.saddles import Saddle, largest_continuation_by_position
from shuttle_marl.exact.solver import BlockLinear, solve_players, successors
from shuttle_marl.exact.sweeps import Choices, after_block_choices, block_choices
from shuttle_marl.game import load_game, model_folder
from shuttle_marl.game.recovery import N_POSITIONS, POSITIONS
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, cumulative_positions, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import hidden_depth

FOLDS: Final = 4
"""Parts of the training matches; effects are compared with each part as fitted without it."""


class Seen:
    """A :class:`~shuttle_marl.exact.solver.Striker` who sees the position before the stroke, and strikes best.

    With Q(s, i, a) the value of a stroke against a position, the value of a state is min_i max_a Q(s, i, a), or the mean over
    positions of max_a Q(s, i, a). Both contract as the largest continuation does, so the bound of
    :mod:`shuttle_marl.exact.fixed_point` holds.

    Args:
        game: with recovery.
        positions: ``[S, 9]`` probabilities of the receiver's positions; None: the receiver chooses best.
    """

    def __init__(self, game: Game, positions: F64 | None = None) -> None:
        self.game, self.contraction = game, largest_continuation_by_position(game)
        waiting = game.waiting
        # The i-th feasible position of each state; where there are fewer, the last one again.
        place = np.minimum(np.arange(waiting.choices.max())[:, None], waiting.choices - 1)
        self._position = np.tile(waiting.position[np.arange(game.n_base_states), place], game.n_blocks)
        again = np.tile(np.arange(len(place))[:, None] >= waiting.choices, game.n_blocks)
        self._games = [met(game, np.eye(N_POSITIONS)[position]) for position in self._position]
        states = np.arange(game.n_states)
        self._share = None if positions is None else np.where(again, 0.0, positions[states, self._position])

    def _answers(self, block: int, plain: F64, after_attack: F64) -> tuple[list[Choices], F64]:
        """The best strokes against each position, and ``[positions, base states]`` probabilities of these."""
        found = [block_choices((known,), block, plain, after_attack) for known in self._games]
        if self._share is not None:
            return found, self._share[:, self.game.block_states(block)]
        worst = np.stack([chosen.value for chosen in found]).argmin(axis=0)
        return found, np.eye(len(found))[:, worst]

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part."""
        found, share = self._answers(block, plain, after_attack)

        def linear(plain: F64, after_attack: F64) -> F64:
            parts = (after_block_choices(self.game, chosen, plain, after_attack) for chosen in found)
            return np.asarray(sum(chance * part for chance, part in zip(share, parts, strict=True)))

        return np.asarray((share * [chosen.value for chosen in found]).sum(axis=0)), linear

    def policy(self, following: F64) -> TabulatedPolicy:
        """The best positions, and the best strokes against them, from the ``[S]`` values of the next states."""
        game, rank, which = self.game, [], []
        for block in range(game.n_blocks):
            found, share = self._answers(block, *successors(game, following, block))
            which.append(share.argmax(axis=0))
            rank.append(np.stack([chosen.rank for chosen in found])[which[-1], np.arange(game.n_base_states)])
        position = self._position[np.concatenate(which), np.arange(game.n_states)]
        waits = cumulative_positions(np.eye(N_POSITIONS)[position])
        return TabulatedPolicy(game=game, cumulative=pure_policy(game, np.concatenate(rank)).cumulative, waits=waits)


def bracket(game: Game) -> dict[str, Any]:
    """Perfect play when positions are hidden and when they are seen, beside people.

    Returns:
        ``people``, ``hidden``, ``seen``: as of :func:`_play`, the last two with the ``value`` at the serve, the fraction of
        rallies that the ``server`` wins and its ``error_bound``, ``mixed_positions``: share of choices of positions that are
        mixed, and ``purified_loss``: what a best response wins above one half against the most likely choices; ``hidden`` also
        with :func:`~shuttle_marl.policy.scorecard.hidden_depth`. ``apart``: fraction of
        shots and of positions that differ between hidden and seen. ``sees``: fraction of rallies won by perfect play that sees
        positions against perfect play that does not and knows it (``known``), and by the best response that sees positions to
        perfect play of the game with hidden ones (``not_known``).
    """
    solution, seen = solve(game), Seen(game)
    perfect, (value, _) = solution.policy[0], solve_players(seen, None, TOLERANCE)
    known = value.odds()
    blind = Saddle((game,), strokes=tuple(block_chances(perfect, block) for block in range(game.n_blocks)))
    response = solve_players(Seen(game, positions_of(perfect)), blind, TOLERANCE)[0]
    depth = hidden_depth(perfect)
    hidden = {
        "value": solution.value_at_serve,
        "server": (1 + solution.value_at_serve) / 2,
        "error_bound": solution.error_bound / 2,
        "mixed_positions": depth["mixed"]["positions"],
        "purified_loss": depth["purified"] - 0.5,
    }
    of_seen = {"value": 2 * known.serving - 1, "server": known.serving, "error_bound": known.error_bound}
    # Perfect play that sees positions is deterministic.
    of_seen |= {"mixed_positions": 0.0, "purified_loss": 0.0}
    played = {"hidden": _play(perfect), "seen": _play(seen.policy(value.striking[1]))}
    mixes = {name: [np.array([*of[name].values()]) for of in played.values()] for name in ("shots", "positions")}
    return {
        "people": _play(tabulate(resolve("bc", game), game)),
        "hidden": {**hidden, **played["hidden"], **depth},
        "seen": {**of_seen, **played["seen"]},
        "apart": {name: float(np.abs(one - other).sum() / 2) for name, (one, other) in mixes.items()},
        "sees": {
            "known": solve_players(seen, Saddle((game,)), TOLERANCE)[0].odds().rally,
            "not_known": response.odds().rally,
        },
    }


def _play(policy: TabulatedPolicy) -> dict[str, Any]:
    """Length of rallies of a policy against itself, and its mixes of ``shots`` and ``positions``."""
    seen = visits(policy, policy)
    waited = seen.states[1] @ positions_of(policy)
    return {
        "length": seen.rally_length,
        "shots": dict(zip(SHOTS, seen.shot_mix(0).tolist(), strict=True)),
        "positions": dict(zip(POSITIONS, (waited / waited.sum()).tolist(), strict=True)),
    }


def evidence(data: Path, model: str) -> dict[str, Any]:
    """What matches say: by group of shot types :func:`~experiments.truth.recovery.aims`, and the effects by discipline.

    Training matches are judged by models and effects that were not fitted to them, validation matches by the shipped ones.
    """
    folder, table = model_folder(model), read_matches(data)
    models, shipped = FittedModels.load(folder), load_recovery(folder)
    assert shipped is not None
    strokes = strokes_of(table).marked(load_hurry(folder))
    train, aside = in_splits(strokes, "train"), in_splits(strokes, "validation")
    seen, validation = strokes.take(train), strokes.rows.take(aside)
    members = softmax(models.m_target.logits(seen.rows.codes))
    targets = [unseen(members, seen.rows.match, EnsembleConfig().folds), models.targets(validation.codes)]
    right = table["landing_x"].to_numpy().astype(np.float64)
    landing = np.concatenate([right[train], right[aside]])
    judged = zip(cross_judged(models, seen, FOLDS), judged_by(models, shipped, validation), strict=True)
    return {
        "aims": aims(Rows.joined([seen.rows, validation]), landing, np.concatenate(targets)),
        "effects": by_discipline([Judged.joined(parts) for parts in judged], strokes.rows),
    }


def recovery_bracket(
    *,
    data: Path | None = None,
    model: str = "default",
    out: Path | None = None,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Compare hidden with seen positions.

    Args:
        data: folder of the download, or a Parquet file of `data convert`; without it only the bracket.
        model: a shipped model or a model folder, with recovery.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    game = load_game(f"{model}:recovery")
    result = {**describe(("numpy", "torch")), "game": game.hash, "bracket": bracket(game)}
    if data is not None:
        result |= evidence(data, model)
    show(result, "recovery_bracket", *(["recovery_aims", "recovery_disciplines"] if data else []), as_json=json_output, out=out)


main = entry_point(recovery_bracket, "python -m experiments.recovery_bracket", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
