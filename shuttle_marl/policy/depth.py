"""Depth of a game: what policies play in it, how rare that is among people, and how far policies get that read little."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import Bools
from shuttle_marl.exact import best_response, evaluate, solve, visits
from shuttle_marl.exact.lists import averaged, cells_of, lists
from shuttle_marl.game.court import third_of
from shuttle_marl.game.stroke import N_SHOTS, SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve

POLICIES: Final = ("minimax", "best-response:bc", "bc", "ppo", "a2c", "sac", "ppo:self-play", "human:0.05")
_ALL: Final = ("own", "incoming", "contact", "duel", "effort", "opponent_effort", "hurried")
LISTS: Final = {
    "nothing": (),
    "incoming_shot": ("incoming_shot", "contact"),
    "incoming_stroke": ("incoming", "contact"),
    "no_own": tuple(part for part in _ALL if part != "own"),
    "no_hurried": tuple(part for part in _ALL if part != "hurried"),
}
"""What the policies of each class read; all of them see the contact offered, which decides what is legal."""
FRONT_COURT: Final = ("net-kill", "net-shot", "cross-court-net-shot")
"""Shot types that no body can play from the back third of the court."""
_BACK: Final = 2
_RARE: Final = 0.01
_OFTEN: Final = 0.02


def depth(game: Game, names: Sequence[str] = POLICIES, *, report: Callable[[str], None]) -> dict[str, Any]:
    """The depth table of a game.

    Args:
        game: the tables.
        names: policies to describe.
        report: called with a line before each stage.

    Returns:
        ``impossible``: number of legal pairs of one of :data:`FRONT_COURT` whose incoming stroke is met in the back third.
        ``policies``: for each name its play against itself (``self``) and against ``bc``: ``shots`` (fraction of its strokes by
        shot type), ``types`` (number of shot types above 2 %), ``bits`` (entropy of the shot mix), ``length`` (strokes of a
        rally), ``rare`` (fraction of its strokes of a shot type that ``bc`` plays in less than 1 % of cases in that state).
        ``lists``: for each class of :data:`LISTS` ``score`` (edge over ``bc``, 1 for the best response), ``exploitability`` and
        ``against_minimax`` (fraction of rallies won against perfect play), each of the best policy found in the class: improved
        lists against ``bc`` and against perfect play, and the mean of perfect play over the cells.
    """
    bc = tabulate(resolve("bc", game), game, "bc")
    unusual = _unusual(bc)
    played = {}
    for name in names:
        report(name)
        policy = bc if name == "bc" else tabulate(resolve(name, game), game, name)
        played[name] = {"self": _play(policy, policy, unusual), "bc": _play(policy, bc, unusual)}
    perfect = solve(game).policy[0]
    best = best_response(bc).value.odds().rally
    classes = {}
    for name, parts in LISTS.items():
        report(f"lists that read {name.replace('_', ' ')}")
        cell = cells_of(game, *parts)
        found = [*lists(bc, cell), *lists(perfect, cell), averaged(perfect, perfect, cell)]
        classes[name] = {
            "score": max((evaluate(each, bc).odds().rally - 0.5) / (best - 0.5) for each in found),
            "exploitability": min(best_response(each).value.odds().value for each in found),
            "against_minimax": max(evaluate(each, perfect).odds().rally for each in found),
        }
    return {"game": game.hash, "impossible": int(impossible(game).sum()) * game.n_blocks, "policies": played, "lists": classes}


def impossible(game: Game) -> Bools:
    """``[base pairs]`` whether a stroke cannot be played from where the incoming one is met."""
    catalogue = game.catalogue
    incoming = game.incoming(game.base_pair_state)
    back = np.append(third_of(catalogue.area) == _BACK, False)[incoming]
    front = np.isin(np.array(SHOTS)[catalogue.shot], FRONT_COURT)
    return np.asarray(back & front[game.base_pair_stroke])


def _unusual(bc: TabulatedPolicy) -> list[Bools]:
    """For each block ``[base pairs]`` whether the average player hardly plays the shot type in the state."""
    game = bc.game
    key = game.base_pair_state * np.int64(N_SHOTS) + game.catalogue.shot[game.base_pair_stroke]
    size = game.n_base_states * N_SHOTS
    return [np.bincount(key, bc.block_probabilities(block), size)[key] < _RARE for block in range(game.n_blocks)]


def _play(policy: TabulatedPolicy, opponent: TabulatedPolicy, unusual: Sequence[Bools]) -> dict[str, Any]:
    game, seen = policy.game, visits(policy, opponent)
    mix = seen.shot_mix(0)
    rare = total = 0.0
    for block, which in enumerate(unusual):
        played = policy.block_probabilities(block) * seen.states[0][game.block_states(block)][game.base_pair_state]
        rare += float(played[which].sum())
        total += float(played.sum())
    some = mix[mix > 0]
    return {
        "shots": dict(zip(SHOTS, mix.tolist(), strict=True)),
        "types": int((mix > _OFTEN).sum()),
        "bits": float(-(some * np.log2(some)).sum()),
        "length": seen.rally_length,
        "rare": rare / total,
    }
