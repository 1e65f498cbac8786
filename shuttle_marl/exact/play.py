"""What a policy plays: shot mix, replies, duels at the net, length of rallies, and strokes that people hardly or cannot play.

And how far policies get that read little. A list is a policy that plays the first legal stroke of an order of preference, one
order for each cell of states; the cells say what it reads. It is improved by exact policy iteration in its class: strokes are
ordered by their mean loss, the value of the best stroke minus their own, over the states of the cell that the policy visits.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64, U16, Bools, Ints
from shuttle_marl.exact.occupancy import Visits, visits
from shuttle_marl.exact.optimal import pure_policy
from shuttle_marl.exact.profile import StatePolicy, block_chances, evaluate, met_by
from shuttle_marl.exact.sweeps import listed, propagate
from shuttle_marl.game.court import BACK, FOREHAND, N_AREAS, N_SIDES, third_of
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.stroke import AROUND_THE_HEAD, FRONT_COURT, N_SHOTS, NET_SHOTS, SHOTS
from shuttle_marl.game.tables import Game

RARE: Final = 0.01  # a shot type that the average player plays less often in a state is rare there
OFTEN: Final = 0.02  # share of a player's strokes above which a shot type counts
KIND: Final = 0.01  # share of a player's strokes above which a shot type to a target area counts
_RUN: Final = 3  # number of cross-court net shots in a row from which a run counts
_ROUNDS: Final = 6
_TOLERANCE: Final = 1e-6
_LITTLE: Final = 1e-12  # weight of states that are never visited, so that the strokes of rare cells have an order too
_SMASH, _LIFT, _SHORT_SERVE, _CROSS = map(SHOTS.index, ("smash", "lift", "short-serve", "cross-court-net-shot"))


def impossible(game: Layout) -> Bools:
    """``[base pairs]`` strokes of the front court met in the back third, and around the head on the striker's forehand side."""
    catalogue, incoming = game.catalogue, game.incoming(game.base_pair_state)
    back, forehand = (
        np.append(part, False)[incoming] for part in (third_of(catalogue.area) == BACK, catalogue.area % N_SIDES == FOREHAND)
    )
    front, around = np.isin(np.array(SHOTS)[catalogue.shot], FRONT_COURT), catalogue.technique == AROUND_THE_HEAD
    return np.asarray(back & front[game.base_pair_stroke] | forehand & around[game.base_pair_stroke])


def unusual(bc: StatePolicy) -> list[Bools]:
    """For each block ``[base pairs]`` whether the average player plays the shot type in the state in less than 1 % of cases."""
    game = bc.game
    key = game.base_pair_state * np.int64(N_SHOTS) + game.catalogue.shot[game.base_pair_stroke]
    size = game.n_base_states * N_SHOTS
    return [np.bincount(key, bc.block_probabilities(block), size)[key] < RARE for block in range(game.n_blocks)]


def mix(shot: Ints, area: Ints, incoming: Ints, above: Bools, weight: F64, in_runs: float) -> dict[str, Any]:
    """Figures of N strokes of a policy or of people.

    Args:
        shot, area: ``[N]`` shot type, and target area or -1.
        incoming: ``[N]`` shot type of the incoming stroke.
        above: ``[N]`` whether the stroke is met above the net.
        weight: ``[N]`` number of such strokes.
        in_runs: number of them in runs of three or more cross-court net shots.

    Returns:
        ``shots``: fraction of the strokes by shot type; ``types``: number of shot types above 2 %; ``bits``: entropy of the shot
        mix; ``kinds``: number of pairs of shot type and target area above 1 % of the strokes to a known area;
        ``smash_after_lift``: fraction of smashes among replies to a lift from above; ``short_serve_replies``: fraction of the
        replies to a short serve by shot type; ``net_runs``: fraction of the net shots, straight or cross-court, that stand in
        runs of three or more cross-court ones of both players. A fraction of no strokes is 0.
    """

    def share(of: Bools) -> F64:
        played = np.bincount(shot[of], weight[of], N_SHOTS)
        return np.asarray(played / max(played.sum(), np.finfo(float).tiny))

    shots, known = share(np.ones(len(shot), dtype=np.bool_)), area >= 0
    kinds = np.bincount(shot[known] * np.int64(N_AREAS) + area[known], weight[known])
    net = float(weight[np.isin(shot, [SHOTS.index(name) for name in NET_SHOTS])].sum())
    return {
        "shots": dict(zip(SHOTS, shots.tolist(), strict=True)),
        "types": int((shots > OFTEN).sum()),
        "bits": float(-(shots[shots > 0] * np.log2(shots[shots > 0])).sum()),
        "kinds": int((kinds > KIND * kinds.sum()).sum()),
        "smash_after_lift": float(share((incoming == _LIFT) & above)[_SMASH]),
        "short_serve_replies": dict(zip(SHOTS, share(incoming == _SHORT_SERVE).tolist(), strict=True)),
        "net_runs": in_runs / net if net else 0.0,
    }


def in_cross_court_runs(shot: Ints, follows: Bools) -> Bools:
    """``[N]`` whether strokes of shot types ``[N]`` stand in a run of three or more cross-court net shots.

    Args:
        follows: ``[N]`` whether a stroke is the next one of its rally after the one before it in the array.
    """
    cross = shot == _CROSS
    run = np.cumsum(~(cross & np.append(False, cross[:-1]) & follows))
    return np.asarray(cross & (np.bincount(run)[run] >= _RUN))


def play(policy: StatePolicy, opponent: StatePolicy, rare: Sequence[Bools]) -> dict[str, Any]:
    """The play of a policy against another, exact.

    Args:
        rare: rare strokes, see :func:`unusual`.

    Returns:
        The figures of :func:`mix`; ``length``: strokes of a rally; ``rare``: fraction of its strokes that are rare among people.
    """
    game, seen = policy.game, visits(policy, opponent)
    strokes = [seen.block_pairs(0, block) for block in range(game.n_blocks)]
    played, stroke, state = np.sum(strokes, axis=0), game.base_pair_stroke, game.base_pair_state
    shot, area = (part[stroke] for part in (game.catalogue.shot, game.catalogue.area))
    figures = mix(shot, area, game.incoming_shot(state), game.contact(state) == 1, played, _in_runs(seen))
    uncommon = sum(float(part[which].sum()) for part, which in zip(strokes, rare, strict=True))
    return {**figures, "length": seen.rally_length, "rare": uncommon / float(played.sum())}


def _in_runs(seen: Visits) -> float:
    """Expected number of strokes of player 0 in runs of three or more cross-court net shots.

    Such a stroke ends, continues or begins three in a row. By inclusion and exclusion the number is ``2 a_0 + a_1 - b_0 - b_1``
    with a_i and b_i the numbers of cross-court net shots of player i after two and after three others in a row. A state knows the
    last two strokes, and what follows it a third one.
    """
    total = 0.0
    for player, (policy, other) in enumerate((seen.policies, seen.policies[::-1])):
        game = policy.game
        cross = game.catalogue.shot[game.base_pair_stroke] == _CROSS
        edge = game.base_pair_state >> 2
        before = np.append(game.catalogue.shot == _CROSS, False)
        after = cross & before[game.edge_own[edge]] & before[game.edge_incoming[edge]]
        blocks = range(game.n_blocks)
        total += (2 - player) * sum(float(seen.block_pairs(player, block)[after].sum()) for block in blocks)
        fourth = propagate(game, [listed(game, block_chances(policy, block) * after) for block in blocks], seen.states[player])
        total -= sum(
            float((other.block_probabilities(b) * fourth[game.block_states(b)][game.base_pair_state])[after].sum())
            for b in blocks
        )
    return total


def cells_of(game: Layout, *parts: str) -> I64:
    """``[S]`` cell of each state for policies that read some parts of it.

    Args:
        parts: methods of the game that take states: ``own``, ``incoming``, ``incoming_shot``, ``contact``, ``duel``, ``effort``,
            ``opponent_effort``, ``hurried``.
    """
    state = np.arange(game.n_states)
    cell = np.zeros(game.n_states, dtype=np.int64)
    for part in parts:
        value = getattr(game, part)(state)
        cell = cell * (int(value.max()) + 1) + value
    return np.unique(cell, return_inverse=True)[1]


def lists(opponent: StatePolicy, cell: Ints, waits: U16 | None = None) -> Iterator[TabulatedPolicy]:
    """Improving lists against an opponent, the best one last.

    Args:
        opponent: on the game that is played.
        cell: ``[S]`` cell of each state, see :func:`cells_of`.
        waits: positions of the lists with recovery, see :class:`~shuttle_marl.game.policy.TabulatedPolicy`.
    """
    game, won = opponent.game.opposite, -1.0
    tables = met_by(game, opponent)
    player: StatePolicy = opponent if opponent.game is game else from_pair_probabilities(game, opponent.pair_probabilities())
    for turn in range(_ROUNDS):
        value = evaluate(player, opponent, tolerance=_TOLERANCE)
        if turn and value.odds().rally <= won:
            return
        if turn:
            won = value.odds().rally
            assert isinstance(player, TabulatedPolicy)
            yield player
        weight = visits(player, opponent, tolerance=_TOLERANCE).states[0]
        player = dataclasses.replace(list_policy(game, cell, mean_losses(tables, cell, value.striking[1], weight)), waits=waits)


def averaged(policy: TabulatedPolicy, opponent: StatePolicy, cell: Ints) -> TabulatedPolicy:
    """The policy that plays each stroke as often as another one does on average in the states of its cell that it visits."""
    game = policy.game
    weight = visits(policy, opponent, tolerance=_TOLERANCE).states[0] + _LITTLE
    n = game.n_strokes
    played, met = (np.zeros((int(cell.max()) + 1) * n) for _ in range(2))
    for block, key in _keys(game, cell):
        here = weight[game.block_states(block)][game.base_pair_state]
        played += np.bincount(key, here * policy.block_probabilities(block), len(played))
        met += np.bincount(key, here, len(met))
    share = np.concatenate([(played / np.maximum(met, _LITTLE))[key] + _LITTLE for _, key in _keys(game, cell)])
    return dataclasses.replace(from_pair_probabilities(game, game.normalized(share)), waits=policy.waits)


def _keys(game: Game, cell: Ints) -> Iterator[tuple[int, I64]]:
    """Each block, and ``[base pairs]`` number of the cell and the stroke of its pairs."""
    for block in range(game.n_blocks):
        yield block, cell[game.block_states(block)][game.base_pair_state] * game.n_strokes + game.base_pair_stroke


def mean_losses(game: Game, cell: Ints, following: F64, weight: F64) -> F64:
    """``[cells * n]`` mean loss of each stroke where it is legal; infinity where it never is.

    Args:
        cell: ``[S]`` cell of each state.
        following: ``[S]`` values of the next states to the receiver.
        weight: ``[S]`` weights of the states.
    """
    size = (int(cell.max()) + 1) * game.n_strokes
    playable = game.playable[: game.n_base_states]
    first = game.base_pair_start[:-1][playable]
    loss, total = np.zeros(size), np.zeros(size)
    for block, key in _keys(game, cell):
        q = game.stroke_values(following, game.block_pairs(block))
        best = np.zeros(game.n_base_states)
        best[playable] = np.maximum.reduceat(q, first)
        share = weight[game.block_states(block)][game.base_pair_state] + _LITTLE
        loss += np.bincount(key, share * (best[game.base_pair_state] - q), size)
        total += np.bincount(key, share, size)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0, loss / total, np.inf)


def list_policy(game: Game, cell: Ints, losses: F64) -> TabulatedPolicy:
    """The policy that plays the legal stroke of the smallest loss of its cell."""
    rank = np.full(game.n_states, -1, dtype=np.int32)
    for block, key in _keys(game, cell):
        # The last entry in this order is the best stroke of its state.
        order = np.lexsort((-losses[key], game.base_pair_state))
        rank[game.block_states(block)][game.base_pair_state[order]] = game.base_pair_rank[order]
    return pure_policy(game, rank)
