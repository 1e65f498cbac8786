"""Health check of a game: perfect play, the best response to the behaviour-cloned player, and how both play, exactly.

A model of badminton that predicts well can still be a bad game: one exploitable corner of the tables, and perfect play is
a stall or a single killing stroke. So every fit is solved, and what perfect play looks like is part of its model card.
"""

from typing import Any

import numpy as np

from shuttle_marl.dynamics.compiled import Support, is_serve_pair
from shuttle_marl.exact.fixed_point import largest_continuation
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.optimal import best_response, solve
from shuttle_marl.exact.profile import StatePolicy
from shuttle_marl.game.rally import Game
from shuttle_marl.game.stroke import SHOTS


def play_statistics(policy: StatePolicy) -> dict[str, Any]:
    """Length, endings and shot mix of the rallies of a policy against itself, exactly."""
    seen = visits(policy, policy, server=0)
    endings = seen.endings()
    faults = endings["fault of player 0"] + endings["fault of player 1"]
    strokes = seen.rally_length
    played = np.stack([seen.shot_mix(player) * seen.states[player].sum() for player in (0, 1)]).sum(axis=0) / strokes
    return {
        "mean_rally": strokes,
        "rallies_ending_on_fault": faults,
        "fault_share": faults / strokes,
        "winner_share": (1 - faults) / strokes,
        "shot_mix": {name: float(share) for name, share in zip(SHOTS, played, strict=True)},
    }


def health(bc: StatePolicy) -> dict[str, Any]:
    """The figures that say whether the solved game is healthy.

    Args:
        bc: the behaviour-cloned average player, on the tables that are checked.
    """
    solution = solve(bc.game)
    perfect = play_statistics(solution.policy[0])
    shots = list(perfect["shot_mix"].values())
    figures = {
        "minimax": perfect,
        "value_at_serve": solution.value_at_serve,
        "largest_shot_share": max(shots),
        "shot_types_above_2_percent": sum(share > 0.02 for share in shots),
        "largest_continuation": largest_continuation(bc.game),
        "best_response_to_bc_wins": best_response(bc).value.odds().rally,
        "bc": play_statistics(bc),
    }
    figures["healthy"] = bool(
        figures["largest_shot_share"] <= 0.45
        and figures["shot_types_above_2_percent"] >= 6
        and 5 <= perfect["mean_rally"] <= 20
        and figures["largest_continuation"] <= 0.997
        and figures["best_response_to_bc_wins"] >= 0.70
    )
    return figures


def extremes(game: Game, support: Support, count: int = 10) -> dict[str, list[dict[str, Any]]]:
    """The legal pairs with the highest and lowest fault and winner probabilities, with what supports them."""
    good, returned, _ = game.stroke_probabilities()
    rally = np.flatnonzero(~is_serve_pair(game))
    probability = {"fault": 1 - good, "winner": good * (1 - returned)}
    counts = {"fault": support.faults, "winner": support.winners}
    limits = {"fault": support.fault_range, "winner": support.winner_range}
    out: dict[str, list[dict[str, Any]]] = {}
    for kind, sign in (("fault", 1), ("fault", -1), ("winner", 1), ("winner", -1)):
        values = probability[kind][rally]
        order = rally[np.argsort(-sign * values, kind="stable")]
        # One pair an edge: the probability hardly depends on the striker's own last stroke.
        _, first = np.unique(game.pair_edge[order], return_index=True)
        listed = []
        for pair in order[np.sort(first)][:count]:
            edge = int(game.pair_edge[pair])
            listed.append({
                "state": game.describe(int(game.pair_state[pair])),
                "stroke": game.catalogue.names[game.pair_stroke[pair]],
                "probability": round(float(probability[kind][pair]), 5),
                "strokes": round(float(support.strokes[edge]), 1),
                "events": round(float(counts[kind][edge]), 1),
                "range": [round(float(x), 5) for x in limits[kind][edge]],
            })  # fmt: skip
        out[f"{'highest' if sign > 0 else 'lowest'} {kind} probability"] = listed
    return out
