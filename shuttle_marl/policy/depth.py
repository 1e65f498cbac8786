"""Depth of a game: what policies play in it, how rare that is among people, and how far policies get that read little."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from shuttle_marl.exact import best_response, evaluate, solve
from shuttle_marl.exact.lists import averaged, cells_of, lists
from shuttle_marl.exact.play import impossible, play, unusual
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import tabulate
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


def depth(game: Game, names: Sequence[str] = POLICIES, *, report: Callable[[str], None]) -> dict[str, Any]:
    """The depth table of a game.

    Args:
        game: the tables.
        names: policies to describe.
        report: called with a line before each stage.

    Returns:
        ``impossible``: number of legal pairs that no body can play (:func:`shuttle_marl.exact.play.impossible`). ``policies``:
        for each name :func:`shuttle_marl.exact.play.play` against itself (``self``) and against ``bc``.
        ``lists``: for each class of :data:`LISTS` ``score`` (edge over ``bc``, 1 for the best response), ``exploitability`` and
        ``against_minimax`` (fraction of rallies won against perfect play), each of the best policy found in the class: improved
        lists against ``bc`` and against perfect play, and the mean of perfect play over the cells.
    """
    bc = tabulate(resolve("bc", game), game, "bc")
    rare = unusual(bc)
    played = {}
    for name in names:
        report(name)
        policy = bc if name == "bc" else tabulate(resolve(name, game), game, name)
        played[name] = {"self": play(policy, policy, rare), "bc": play(policy, bc, rare)}
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
