"""Layout tables and thresholds from replies and probabilities, and policies as tables over legal pairs.

A policy is one 16-bit cumulative probability for each legal pair of a state and a stroke.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import zstandard
from numpy.random import Generator

from shuttle_marl.base.arrays import F64, I32, U8, U16, Bools, Floats, Intp, Ints
from shuttle_marl.base.files import content_hash, replace_file
from shuttle_marl.base.tensor_files import read_tensors, tensor_bytes
from shuttle_marl.game.draws import CHOICE_ONE, chosen
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.policy import (
    Observation,
    Policy,
    PolicyError,
    States,
    Waits,
    act,
    called,
    checked_positions,
    checked_probabilities,
    reads_score,
)
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import HURRY_ONE, Game, GameError
from shuttle_marl.game.thresholds import ONE

SUM_TOLERANCE: Final = 1e-6
"""Tolerance of the sum of the probabilities of the strokes of a state, which is 1."""


def layout(catalogue: Catalogue, replies: Bools, *, duels: bool = False) -> dict[str, Any]:
    """The index tables of a game from who may answer what.

    Args:
        replies: ``[n + 1, n]`` whether stroke z may answer stroke y (row n: at the start of a rally). The contact height
            of z is the contact from which it is legal.
        duels: whether the state counts net shots in a row.

    Returns:
        ``edge_own``, ``edge_incoming``, ``edge_duel``, ``reply_start``, ``reply_count``, ``reply_edge`` of
        :class:`~shuttle_marl.game.tables.Game`. Only strokes that can be reached from the serve get edges.

    Raises:
        GameError: a reachable stroke has no legal reply from one of the contacts, or a serve is no serve.
    """
    n = len(catalogue)
    if (replies[n] != catalogue.is_serve).any() or replies[:n, catalogue.is_serve].any():
        raise GameError("exactly the serves must be legal at the start, and only there")
    is_net = np.append(catalogue.is_net_shot & duels, False)
    edges: dict[tuple[int, int, int], int] = {(n, n, 0): 0}
    reply_edge: list[int] = []
    reply_start = np.zeros((n + 1, 2, 2), dtype=np.int32)
    reply_count = np.zeros((n + 1, 2), dtype=np.int32)
    for y in [n, *np.flatnonzero(_reachable(replies)[:n]).tolist()]:
        for contact in (0, 1):
            strokes = np.flatnonzero(replies[y] & (catalogue.height == contact)).tolist()
            if not strokes and y != n:
                raise GameError(f"no legal reply to {catalogue.names[y]} from contact {contact}")
            reply_count[y, contact] = len(strokes)
            for longer in (0, 1):
                # The replies to a net shot are listed twice: those that make a duel of two strokes, and of three or more.
                if longer and not is_net[y]:
                    reply_start[y, 1, contact] = reply_start[y, 0, contact]
                    continue
                reply_start[y, longer, contact] = len(reply_edge)
                for z in strokes:
                    duel = (LONGEST_DUEL - 1 + longer if is_net[y] else 1) if is_net[z] else 0
                    reply_edge.append(edges.setdefault((y, z, duel), len(edges)))
    own, incoming, duel_of = np.array(list(edges), dtype=np.int32).T
    return {
        "edge_own": np.ascontiguousarray(own),
        "edge_incoming": np.ascontiguousarray(incoming),
        "edge_duel": np.ascontiguousarray(duel_of),
        "reply_start": reply_start,
        "reply_count": reply_count,
        "reply_edge": np.array(reply_edge, dtype=np.int32),
    }


def _reachable(replies: Bools) -> Bools:
    """``[n + 1]`` strokes that can be played in a rally, and its start."""
    start = len(replies) - 1
    reachable = np.zeros(len(replies), dtype=bool)
    frontier = [start]
    while frontier:
        y = frontier.pop()
        if not reachable[y]:
            reachable[y] = True
            frontier.extend(np.flatnonzero(replies[y]).tolist())
    return reachable


def base_pairs(tables: dict[str, I32]) -> int:
    """Number of base pairs of the index tables of :func:`layout`: the rows that its thresholds need."""
    return 2 * int(tables["reply_count"][tables["edge_incoming"]].sum())


def thresholds(p_good: F64, p_returned: F64, p_above: F64) -> U16:
    """Fixed-point thresholds ``[P, 3]`` from the three probabilities, each rounded to the nearest 1/65536.

    The first three outcomes together never reach 1, so the last one keeps at least 1/65536.
    """
    fault = 1 - p_good
    winner = fault + p_good * (1 - p_returned)
    below = winner + p_good * p_returned * (1 - p_above)
    cumulative = np.rint(np.stack([fault, winner, below], axis=-1) * ONE)
    if not np.isfinite(cumulative).all():
        raise GameError("a probability of the dynamics is not a number; the model is damaged")
    return np.clip(cumulative, 0, ONE - 1).astype(np.uint16)


def hurry_units(p: F64) -> U8:
    """Fixed-point probabilities of a hurried receiver, each rounded to the nearest 1/256 and at most 255/256."""
    if not np.isfinite(p).all():
        raise GameError("a probability of a hurried receiver is not a number; the model is damaged")
    return np.clip(np.rint(p * HURRY_ONE), 0, HURRY_ONE - 1).astype(np.uint8)


_CHUNK = 4096
_LEVEL: Final = 9


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TabulatedPolicy:
    """A policy on every state of one game.

    Attributes:
        game: the game it was compiled for.
        cumulative: ``[P]`` uint16, probability of the legal strokes of a state up to and including this one, in units of
            1/65535; draws choose from it by :func:`shuttle_marl.game.draws.chosen`.
        waits: ``[S, 9]`` uint16, the same for the positions up to and including each one where the opponent is in each state;
            None: as people (and in games without recovery).
    """

    game: Game
    cumulative: U16
    waits: U16 | None = None

    def __repr__(self) -> str:
        return f"TabulatedPolicy(hash={self.hash[:12]!r}, game={self.game!r})"

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 of the tables, hexadecimal."""
        positions = b"" if self.waits is None else self.waits.tobytes()
        return content_hash(self.cumulative.tobytes() + positions)

    def pair_probabilities(self) -> F64:
        """``[P]`` probability of each legal pair given its state, exactly as it is played from the table."""
        return np.concatenate([self.block_probabilities(block) for block in range(self.game.n_blocks)])

    def position_probabilities(self) -> F64 | None:
        """``[S, 9]`` probability of each position where the opponent is in each state; None: those of people."""
        return None if self.waits is None else position_shares(self.waits)

    def probability_of(self, pairs: Ints) -> F64:
        """Probability of each of some legal pairs given its state, of any shape."""
        lower = np.where(self.game.base_pair_rank[pairs % self.game.n_base_pairs] > 0, self.cumulative[pairs - 1], 0)
        return (self.cumulative[pairs].astype(np.int64) - lower) / CHOICE_ONE

    def block_probabilities(self, block: int) -> F64:
        """``[base pairs]`` probability of each legal pair of one block of states."""
        return self.block_units(block) / np.float64(CHOICE_ONE)

    def block_units(self, block: int) -> U16:
        """``[base pairs]`` probability of each legal pair of one block of states, in units of 1/65535."""
        upper = self.cumulative[self.game.block_pairs(block)]
        own = np.diff(upper, prepend=upper[:1])
        first = self.game.base_pair_start[:-1][self.game.playable[: self.game.n_base_states]]
        own[first] = upper[first]
        return own

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probability of each stroke; see :class:`shuttle_marl.game.policy.Policy`."""
        game = self.game
        if states.game.hash != game.hash:
            raise PolicyError("this policy was tabulated for another game; tabulate it for this one, or move it with exact.moved")
        p = np.zeros((len(states), game.n_strokes))
        rows, pairs = game.pairs(states.state)
        p[rows, game.base_pair_stroke[pairs % game.n_base_pairs]] = self.probability_of(pairs)
        return p

    def positions(self, states: States) -> F64:
        """``[B, 9]`` probability of each position; see :class:`shuttle_marl.game.policy.Waits`."""
        if self.waits is None:
            return self.game.people_positions(states.state)
        return position_shares(self.waits[states.state])

    def choose_position(self, state: Ints, draw: Ints) -> Intp:
        """``[B]`` position in which the policy waits where the opponent is in each state.

        Args:
            draw: ``[B]`` uniform integers in [0, 65535), see :func:`shuttle_marl.game.draws.position_draw`.
        """
        return chosen(self.waiting_table[state], draw)

    @functools.cached_property
    def waiting_table(self) -> U16:
        """``[S, 9]`` cumulative probabilities of positions: ``waits``, or those of people."""
        if self.waits is not None:
            return self.waits
        return cumulative_positions(self.game.people_positions(np.arange(self.game.n_states)))

    def act(self, observation: Observation, mask: npt.ArrayLike | None = None, rng: Generator | None = None) -> int | Intp:
        """Draw a stroke for an observation, see :func:`shuttle_marl.game.policy.act`; without ``rng``, from fresh entropy."""
        return act(self, self.game, observation, mask, np.random.default_rng(rng))

    def choose(self, state: Ints, draw: Ints) -> Intp:
        """``[B]`` which of its legal strokes each state plays.

        Args:
            draw: ``[B]`` uniform integers in [0, 65535), see :func:`shuttle_marl.game.draws.choice_draw`.
        """
        return chosen(self.padded.take(state, axis=0), draw)

    @functools.cached_property
    def padded(self) -> U16:
        """``[S, K]`` cumulative probabilities, K the largest number of legal strokes; filled up with 65535."""
        game = self.game
        width = int(game.legal_count(np.arange(game.n_states)).max())
        table = np.full((game.n_states, width), CHOICE_ONE, dtype=np.uint16)
        blocks = table.reshape(game.n_blocks, game.n_base_states, width)
        blocks[:, game.base_pair_state, game.base_pair_rank] = self.cumulative.reshape(game.n_blocks, -1)
        table.flags.writeable = False
        return table

    def _arrays(self) -> dict[str, U16]:
        return {"cumulative": self.cumulative} | ({} if self.waits is None else {"waits": self.waits})

    def save(self, path: Path, metadata: dict[str, str] | None = None) -> None:
        """Write the table as safetensors, with its hash and that of the game, beside and moved into place."""
        header = {"game": self.game.hash, "hash": self.hash, **(metadata or {})}
        replace_file(path, tensor_bytes(self._arrays(), header))

    def packed(self) -> bytes:
        """The table as its differences modulo 2^16, low bytes before high bytes, compressed by zstd with a checksum."""
        numbers = np.concatenate([part.ravel() for part in self._arrays().values()])
        differences = np.diff(numbers, prepend=np.uint16(0)).astype("<u2")
        compressor = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)
        return compressor.compress(differences.view(np.uint8).reshape(-1, 2).T.tobytes())

    @classmethod
    def unpacked(cls, content: bytes, game: Game, where: str) -> "TabulatedPolicy":
        """Reverse :meth:`packed`.

        Raises:
            ValueError: it does not have as many numbers as the game has legal pairs, and states with positions.
            zstandard.ZstdError: it is not compressed by zstd, or damaged.
            PolicyError: it is no table over the legal strokes of the game; ``where`` begins the message.
        """
        size, waits = game.n_pairs, game.n_states * N_POSITIONS
        found = zstandard.frame_content_size(content) // 2
        if found not in (size, size + waits):  # what would expand to more is never expanded
            raise ValueError(f"it is of another game; expected the {game.n_pairs:,} legal pairs of game {game.hash[:12]}")
        unpacked = zstandard.ZstdDecompressor().decompress(content, allow_extra_data=False)
        differences = np.frombuffer(unpacked, dtype=np.uint8).reshape(2, -1).T.copy().view("<u2").ravel()
        numbers = np.cumsum(differences, dtype=np.uint16)
        positions = numbers[size:].reshape(game.n_states, N_POSITIONS) if found > size else None
        return cls.checked(numbers[:size], game, where, waits=positions)

    @classmethod
    def checked(
        cls, cumulative: npt.NDArray[Any], game: Game, where: str, *, waits: npt.NDArray[Any] | None = None
    ) -> "TabulatedPolicy":
        """A table from untrusted numbers.

        Raises:
            PolicyError: they are no cumulative probabilities over the legal pairs of the game, or over its feasible positions;
                ``where`` begins the message.
        """
        last = game.last_pairs
        if cumulative.shape != (game.n_pairs,) or cumulative.dtype != np.uint16 or (cumulative[last] != CHOICE_ONE).any():
            raise PolicyError(f"{where}: not a table over the {game.n_pairs:,} legal pairs of this game; save the policy again")
        falls = cumulative[1:] < cumulative[:-1]
        falls[last[:-1]] = False
        if falls.any():
            raise PolicyError(f"{where}: a cumulative probability falls; the file is damaged, save the policy again")
        if waits is not None:
            _check_positions(waits, game, where)
        return cls(game=game, cumulative=cumulative, waits=waits)

    @classmethod
    def load(cls, path: Path, game: Game) -> "TabulatedPolicy":
        """Read a table written by :meth:`save`.

        Raises:
            PolicyError: the file is missing or damaged, or is a policy for another game.
        """
        try:
            header, arrays = read_tensors(path)
            cumulative, waits = arrays["cumulative"], arrays.get("waits")
        except (OSError, KeyError, ValueError) as error:
            raise PolicyError(f"{path}: no readable table of a policy ({error})") from error
        if header.get("game") != game.hash:
            made_for = str(header.get("game"))[:12]
            raise PolicyError(
                f"{path}: the policy was tabulated for game {made_for}, this is {game.hash[:12]}; tabulate it again"
            )
        table = cls.checked(cumulative, game, str(path), waits=waits)
        if header.get("hash") != table.hash:
            raise PolicyError(f"{path}: the table does not match its hash; the file is damaged, save the policy again")
        return table


def _check_positions(waits: npt.NDArray[Any], game: Game, where: str) -> None:
    """Check untrusted cumulative probabilities of positions.

    Raises:
        PolicyError: they are no distributions over feasible positions; ``where`` begins the message.
    """
    if waits.shape != (game.n_states, N_POSITIONS) or waits.dtype != np.uint16 or (waits[:, -1] != CHOICE_ONE).any():
        raise PolicyError(f"{where}: no table of nine positions in the {game.n_states:,} states of this game")
    steps = np.diff(waits.astype(np.int32), axis=1, prepend=0)
    infeasible = np.tile(~game.waiting.mask(np.arange(game.n_base_states)), (game.n_blocks, 1))
    if (steps < 0).any() or steps[infeasible].any():
        raise PolicyError(f"{where}: a position that is not feasible, or a cumulative probability that falls")


def tabulate(policy: Policy, game: Game) -> TabulatedPolicy:
    """Evaluate a policy on every state.

    Raises:
        PolicyError: the policy reads more than the state, raises, or is no distribution over the legal strokes somewhere.
    """
    if isinstance(policy, TabulatedPolicy) and policy.game.hash == game.hash:
        return policy
    if reads_score(policy):
        raise PolicyError(f"{called(policy)} reads the score, so it has no table over states; evaluate it by sampling")
    base = np.flatnonzero(game.playable[: game.n_base_states]).astype(np.int32)
    cumulative = np.empty(game.n_pairs, np.uint16)
    p = np.zeros(game.n_base_pairs)
    for block in range(game.n_blocks):
        for chunk in np.array_split(base, max(1, len(base) // _CHUNK)):
            rows = checked_probabilities(policy, States(game=game, state=chunk + block * game.n_base_states))
            row, pairs = game.pairs(chunk)
            p[pairs] = rows[row, game.base_pair_stroke[pairs]]
        cumulative[game.block_pairs(block)] = _cumulative(game, p)
    return TabulatedPolicy(game=game, cumulative=cumulative, waits=_tabulated_positions(policy, game))


def _tabulated_positions(policy: Policy, game: Game) -> U16 | None:
    """``[S, 9]`` cumulative probabilities of the positions of a policy; None where it waits as people do."""
    if not (game.hides and isinstance(policy, Waits)):
        return None
    states = np.arange(game.n_states, dtype=np.int32)
    found = np.concatenate([checked_positions(policy, States(game=game, state=part)) for part in np.array_split(states, 16)])
    table = cumulative_positions(found)
    return None if np.array_equal(table, cumulative_positions(game.people_positions(states))) else table


def cumulative_positions(p: F64) -> U16:
    """``[S, 9]`` cumulative probabilities of positions in units of 1/65535, of probabilities that sum to 1 in each state."""
    total = np.cumsum(p, axis=1)
    return np.asarray(np.rint(total / total[:, -1:] * CHOICE_ONE).astype(np.uint16))


def position_shares(cumulative: U16) -> F64:
    """``[..., 9]`` probabilities of positions from those of :func:`cumulative_positions`."""
    return np.asarray(np.diff(cumulative.astype(np.float64), axis=-1, prepend=0) / CHOICE_ONE)


def hash_of(first: TabulatedPolicy, second: TabulatedPolicy) -> str:
    """Hash of a policy from its tables at seats 0 and 1: that of the table if they are the same, else of both."""
    if first.hash == second.hash:
        return first.hash
    return content_hash(f"seats {first.hash} {second.hash}".encode())


def from_pair_probabilities(game: Game, p: Floats) -> TabulatedPolicy:
    """Compile ``[P]`` probabilities to a table; rounds the cumulative probability to 1/65535.

    Raises:
        PolicyError: those of a state do not add up to 1.
    """
    # One block after the other: a policy that does not look at the efforts has the same table in all of them.
    blocks = [_cumulative(game, p[game.block_pairs(block)]) for block in range(game.n_blocks)]
    return TabulatedPolicy(game=game, cumulative=np.concatenate(blocks))


def _cumulative(game: Game, p: Floats) -> U16:
    """``[base pairs]`` cumulative probabilities of one block of states, in units of 1/65535."""
    total = np.r_[0.0, np.cumsum(p, dtype=np.float64)]
    probability = total[1:] - total[game.base_pair_start[game.base_pair_state]]
    sums = probability[game.base_pair_start[game.base_pair_state + 1] - 1]
    if not np.allclose(sums, 1, rtol=0, atol=SUM_TOLERANCE):
        raise PolicyError("probabilities of strokes that do not add up to 1 in every state")
    probability /= sums
    return np.asarray(np.rint(probability * CHOICE_ONE).astype(np.uint16))
