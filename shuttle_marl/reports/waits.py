"""Where players wait for the opponent's stroke, after their most frequent strokes.

Positions are those of annotated matches at the moment in which the opponent strikes. Marked in a video, they lie decimetres
deeper at one end of the court than at the other. So both ends count alike, and a player is compared with the opponents in the
same matches.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from scipy import special

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.data.hands import receiver_hands
from shuttle_marl.data.schema import rally_numbers
from shuttle_marl.dynamics.habits import Tally
from shuttle_marl.game.court import HANDS
from shuttle_marl.game.recovery import N_POSITIONS, position_of
from shuttle_marl.game.scoring import RULES
from shuttle_marl.game.shipped import RELIABLE, Estimate
from shuttle_marl.game.stroke import N_SERVES, N_SHOTS, SHOTS
from shuttle_marl.reports.habits import FALSE_DISCOVERIES, adjusted

MOST: Final = 3
LEAST_METRES: Final = 0.1  # smaller differences are of no use on court, and are not named [m]
LEAST_MATCHES: Final = 5  # matches of a player from which on intervals resample matches; of fewer they resample rallies
_RESAMPLES: Final = 2000
_BOUNDS: Final = (0.05, 0.95)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Place:
    """A mean coordinate of a waiting player [m], with 90 % intervals."""

    mean: Estimate
    difference: Estimate  # from the opponents in the same matches; NaN where they played no such strokes at both ends
    p: float  # p-value of the difference; NaN where one of them played it less than 20 times
    q: float = float("nan")  # the same with a correction for the number of differences
    clear: bool = False  # whether the difference is more than chance, with this correction, and large enough


@dataclasses.dataclass(frozen=True, kw_only=True)
class Wait:
    """Where a player waits after strokes of one shot type."""

    player: int  # index of the player
    shot: str
    strokes: int  # with a known position, of the player
    others: int  # of the opponents in the same matches
    positions: tuple[float, ...]  # [9] share of each of `POSITIONS`
    depth: Place  # distance from the net
    side: Place  # distance from the middle line towards the forehand side; an unknown hand counts as right


def waits(strokes: pa.Table, players: Sequence[str], *, seed: int = 0) -> list[Wait]:
    """Where players wait after their three most frequent shot types; empty without known positions.

    Args:
        strokes: of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order. Simulated strokes do not count: no player
            chose their positions.
        seed: random seed of the intervals.
    """
    rows = _Rows.of(strokes)
    found: list[Wait] = []
    for player, name in enumerate(players):
        own = rows.player == name
        played = np.bincount(rows.shot[own & (rows.shot >= N_SERVES)], minlength=N_SHOTS)
        for kind in np.argsort(-played, kind="stable")[:MOST].tolist():
            mine = rows.known & own & (rows.shot == kind)
            others = rows.known & ~own & (rows.shot == kind) & np.isin(rows.match, rows.match[mine])
            if mine.any():
                found.append(_wait(rows, player, kind, mine, others, np.random.default_rng([seed, player, kind])))
    tested = [place.p for wait in found for place in (wait.depth, wait.side) if place.p == place.p]
    corrected = iter(adjusted(tested).tolist())

    def marked(place: Place) -> Place:
        _, low, high = place.difference
        q = next(corrected) if place.p == place.p else place.p
        named = q <= FALSE_DISCOVERIES and not low <= 0 <= high and abs(place.difference.value) >= LEAST_METRES
        return dataclasses.replace(place, q=q, clear=named)

    return [dataclasses.replace(wait, depth=marked(wait.depth), side=marked(wait.side)) for wait in found]


class Difference(NamedTuple):
    """A difference of a player from others that the data support: where they wait, and its size and interval [m];
    ``q`` as in :class:`Place`."""

    wait: Wait
    kind: str
    value: float
    low: float
    high: float
    q: float


def differences(found: Sequence[Wait], *, match: bool) -> list[Difference]:
    """The largest first. ``match``: the players are each other's only opponents, so a difference is named for one of them."""
    first = {wait.shot for wait in found if wait.player == 0}
    told = [each for wait in found if not (match and wait.player and wait.shot in first) for each in named(wait)]
    return sorted(told, key=lambda each: -each.value)


def named(wait: Wait) -> Iterator[Difference]:
    """The differences of one row."""
    for place, kinds in ((wait.depth, ("closer", "farther")), (wait.side, ("backhand", "forehand"))):
        if place.clear:
            low, high = sorted(map(abs, place.difference[1:]))
            yield Difference(wait, kinds[place.difference.value > 0], abs(place.difference.value), low, high, place.q)


class Stand(NamedTuple):
    """Where a player stands after strokes of one shot type: ``[9]`` shares of the positions."""

    shot: str
    strokes: int
    positions: tuple[float, ...]


def stands(own: Tally, found: Sequence[Wait]) -> list[Stand]:
    """After the three most frequent shot types of a player: of some rows, or else as a model counted them."""
    if found:
        return [Stand(each.shot, each.strokes, each.positions) for each in found]
    total = own.positions.sum(axis=1)
    total[:N_SERVES] = 0
    kinds = [kind for kind in np.argsort(-total, kind="stable")[:MOST].tolist() if total[kind] >= RELIABLE]
    return [Stand(SHOTS[kind], int(total[kind]), tuple((own.positions[kind] / total[kind]).tolist())) for kind in kinds]


class _Rows(NamedTuple):
    """Strokes, with the position of the striker when the opponent strikes next."""

    player: npt.NDArray[np.object_]
    shot: I64
    match: I64
    end: I64
    rally: I64
    known: Bools
    depth: F64
    side: F64

    @classmethod
    def of(cls, strokes: pa.Table) -> "_Rows":
        def column(name: str) -> F64:
            return np.asarray(strokes[name].cast(pa.float64()).to_numpy(zero_copy_only=False))

        def after(values: F64) -> F64:
            return np.append(values[1:], np.nan)

        rally, game = rally_numbers(strokes), column("game").astype(np.int64)
        rules = [RULES[name or "21"] for name in strokes["rules"].to_pylist()]
        last, half = np.array([(2 * each.games - 1, (each.points + 1) // 2) for each in rules], dtype=np.int64).reshape(-1, 2).T
        changed = (game >= np.maximum(last, 2)) & (np.fmax(column("points"), column("points_opponent")) >= half)
        x, y = after(column("receiver_x")), after(column("receiver_y"))
        left = after((receiver_hands(strokes) == HANDS.index("left")).astype(np.float64)) == 1
        follows = (after(rally.astype(np.float64)) == rally) & (after(column("stroke")) == column("stroke") + 1)
        played = strokes["source"].to_numpy(zero_copy_only=False).astype(object) != "simulated"
        return cls(
            player=strokes["player"].to_numpy(zero_copy_only=False).astype(object),
            shot=column("shot").astype(np.int64),
            match=strokes["match"].combine_chunks().dictionary_encode().indices.to_numpy().astype(np.int64),
            end=(game + changed) % 2,
            rally=rally,
            known=follows & np.isfinite(x + y) & played,
            depth=y,
            side=np.where(left, x, -x),  # the receiver looks the other way than the striker
        )


def _wait(rows: _Rows, player: int, kind: int, mine: Bools, others: Bools, rng: np.random.Generator) -> Wait:
    used = np.flatnonzero(mine | others)
    match, place = np.unique(rows.match[used], return_inverse=True)
    cell = 2 * place + rows.end[used]
    own, other = mine[used], others[used]
    n, m = (np.bincount(cell[which], minlength=2 * len(match)).reshape(-1, 2) for which in (own, other))
    both = np.asarray((n > 0).all(axis=1))
    fair = (both & np.asarray((m > 0).all(axis=1)))[place]
    # Both ends of a match weigh alike, and the opponents' match as much as the player's.
    whole = n.sum(axis=1)[place] / 2
    even = np.where(both[place], whole / np.maximum(1, n.ravel()[cell]), 1.0)
    weights = np.stack([own * even, own * fair * even, other * fair * whole / np.maximum(1, m.ravel()[cell])])
    cluster = np.unique(rows.match[used] if both.sum() >= LEAST_MATCHES else rows.rally[used], return_inverse=True)[1]
    values = np.stack([np.ones(len(used)), rows.depth[used], rows.side[used]])
    size = int(cluster.max()) + 1
    sums = np.stack([np.bincount(cluster, w * v, minlength=size) for v in values for w in weights], axis=1)
    drawn = rng.multinomial(size, np.full(size, 1 / size), _RESAMPLES).astype(np.float64) @ sums
    enough = min((own & fair).sum(), (other & fair).sum()) >= RELIABLE
    positions = np.bincount(position_of(values[2][own], values[1][own]), weights[0][own], minlength=N_POSITIONS)
    depth, side = (_place(sums.sum(axis=0), drawn, number, size, enough=bool(enough)) for number in (1, 2))
    shares = tuple(float(share) for share in positions / positions.sum())
    counts = {"strokes": int(own.sum()), "others": int(other.sum())}
    return Wait(player=player, shot=SHOTS[kind], **counts, positions=shares, depth=depth, side=side)


def _place(total: F64, drawn: F64, number: int, clusters: int, *, enough: bool) -> Place:
    """``total``: ``[9]`` sums of weights and of two weighted coordinates; ``drawn``: those of resamples."""

    def means(sums: F64) -> tuple[F64, F64]:
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = sums[..., 3 * number : 3 * number + 3] / sums[..., :3]
        return mean[..., 0], mean[..., 1] - mean[..., 2]

    (mean, difference), resampled = means(total), means(drawn)
    estimates = []
    for value, those in zip((mean, difference), resampled, strict=True):
        some = those[np.isfinite(those)]
        low, high = np.quantile(some, _BOUNDS) if clusters > 1 and len(some) and np.isfinite(value) else (np.nan, np.nan)
        estimates.append(Estimate(float(value), float(low), float(high)))
    p = float("nan")
    if enough and clusters > 1:
        error = float(np.nanstd(resampled[1])) * np.sqrt(clusters / (clusters - 1))
        p = float(2 * special.stdtr(clusters - 1, -abs(difference) / error)) if error > 0 else float(difference == 0)
    return Place(mean=estimates[0], difference=estimates[1], p=p)
