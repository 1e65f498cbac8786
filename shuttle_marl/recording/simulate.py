"""Simulated matches: whole ones, played by the kernel, as rallies of a log and as a table of strokes."""

import itertools
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.data.clean import Account
from shuttle_marl.data.upstream import discipline
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game import draws
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.recording.header import LogHeader, Player
from shuttle_marl.recording.kernel_rallies import rallies_of
from shuttle_marl.recording.schema import Rallies
from shuttle_marl.recording.stroke_table import stroke_table


class SimulationError(ShuttleError):
    """Players or probabilities with which no match can be simulated."""


def simulate(game: Game, players: Mapping[str, npt.NDArray[np.floating]], *, matches: int, seed: int) -> pa.Table:
    """Play matches (best of three games to 21) and write every stroke down.

    Pairs of players of one discipline meet in turn; a player who is in neither list of :mod:`shuttle_marl.data.upstream`
    meets all others.

    Args:
        game: the tables.
        players: ``[P]`` probability of each legal pair given its state, by player; as
            ``TabulatedPolicy.pair_probabilities`` gives them.
        matches: number of matches.
        seed: of all draws; the same arguments give the same table.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, see :func:`~shuttle_marl.recording.stroke_table`; matches
        are called ``simulated-1-PLAYER-PLAYER`` and so on.

    Raises:
        SimulationError: no two players of one discipline, or probabilities that do not fit the game.
    """
    _, rallies = simulated_rallies(game, players, matches=matches, seed=seed)
    names, pairs = list(players), _pairs(list(players))
    number = rallies.match.astype(np.int64) * len(pairs) + rallies.pairing
    titles = [f"simulated-{i + 1}-{a}-{b}" for i, (a, b) in zip(range(matches), itertools.cycle(pairs), strict=False)]
    rng = np.random.default_rng([seed, matches])
    return stroke_table(rallies, game.catalogue, names, [titles[i] for i in number.tolist()], rng)


def simulated_rallies(
    game: Game, players: Mapping[str, npt.NDArray[np.floating]], *, matches: int, seed: int
) -> tuple[LogHeader, Rallies]:
    """The rallies of :func:`simulate`, and the header with which a log of them can be played again.

    Match m of a pair has the draws that a league with ``matches_per_draw=1`` would give it.

    Raises:
        SimulationError: see :func:`simulate`.
    """
    from shuttle_marl.kernel import Matches, play_matches  # noqa: PLC0415  numba is slow to import

    if matches < 1:
        raise SimulationError(f"{matches} matches: expected at least one")
    names = list(players)
    pairs = _pairs(names)
    tables = [_table(game, name, p) for name, p in players.items()]
    keys = [draws.pairing_key(*pair) for pair in pairs]
    number = np.arange(matches)
    match, pairing = np.divmod(number, len(pairs))
    entrant = np.array([[names.index(a), names.index(b)] for a, b in pairs], np.int32)[pairing]
    key = draws.stream(seed, np.array(keys, np.uint64)[pairing], match)
    played = play_matches(game, Matches(entrant=entrant, first_server=(number % 2).astype(np.int8), key=key), tables)
    header = LogHeader(
        seed=seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=tuple(Player(name=name, hash=table.hash) for name, table in zip(names, tables, strict=True)),
        pairings=tuple(keys),
        matches_per_draw=1,
    )
    return header, rallies_of(played, pairing=pairing[played.match], match=match[played.match], policy=entrant)


def account_of(strokes: pa.Table) -> Account:
    """The account of a simulated table, of which nothing was dropped."""
    rallies = strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows
    return Account(
        matches=len(strokes["match"].unique()),
        rallies=rallies,
        rallies_kept=rallies,
        strokes=strokes.num_rows,
        strokes_kept=strokes.num_rows,
        dropped={},
        area_agreement=None,
    )


def _pairs(players: list[str]) -> list[tuple[str, str]]:
    kinds = {name: discipline(name) for name in players}
    pairs = [
        (a, b) for a, b in itertools.combinations(players, 2) if kinds[a] is None or kinds[b] is None or kinds[a] == kinds[b]
    ]
    if not pairs:
        raise SimulationError(f"players {', '.join(players) or 'none'}: expected at least two of one discipline")
    return pairs


def _table(game: Game, name: str, p: npt.NDArray[np.floating]) -> TabulatedPolicy:
    if np.shape(p) != (game.n_pairs,) or not (np.asarray(p) >= 0).all():
        raise SimulationError(f"player {name!r}: expected {game.n_pairs} probabilities, one for each legal pair, none negative")
    sums = game.sum_by_state(p)
    off = np.where(game.playable, np.abs(sums - 1), 0)
    if (off > 1e-4).any():
        state = int(off.argmax())
        raise SimulationError(f"player {name!r}: probabilities sum to {sums[state]:g}, not 1, in state: {game.describe(state)}")
    return from_pair_probabilities(game, p)
