"""Policies: probabilities over the catalogue for a batch of states, nothing illegal. The contract, and policies as tables.

A table is one 16-bit cumulative probability for each legal pair of a state and a stroke.
"""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import zstandard
from numpy.random import Generator

from shuttle_marl.base.arrays import F64, I16, I32, I64, U16, Bools, Floats, Intp, Ints
from shuttle_marl.base.errors import ShuttleError, described
from shuttle_marl.base.files import content_hash, replace_file
from shuttle_marl.base.tensor_files import read_tensors, tensor_bytes
from shuttle_marl.game.draws import CHOICE_ONE, chosen
from shuttle_marl.game.layout import RALLY_WIDTH, SWAP, states_of
from shuttle_marl.game.recovery import N_POSITIONS, POSITIONS
from shuttle_marl.game.scoring import BWF
from shuttle_marl.game.stroke import frozen
from shuttle_marl.game.tables import Game

LAGS: Final = 4  # strokes of a rally that policies may read: incoming, the striker's own last one, and one more of either player
STAGES: Final = {"length": 2, "end": 1}  # stages of a rally and of a game in which people choose differently, see `stages_of`
_LONG: Final = (19, 27)
SUM_TOLERANCE: Final = 1e-6  # tolerance of the sum of the probabilities of the strokes of a state, which is 1
_CHUNK: Final = 4096
_LEVEL: Final = 9


class PolicyError(ShuttleError):
    """A policy that cannot be found, raises, or returns something that is no distribution over the legal strokes."""


class HistoryError(PolicyError):
    """A policy that reads the rally so far, where only the state is known."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class States:
    """A batch of B decisions, seen by the striker. All arrays are read-only.

    Attributes:
        game: the tables of the game.
        state: ``[B]`` int32 state numbers.
        score: ``[B, 4]`` int16 points of the striker, points of the receiver, games of the striker, games of the
            receiver before this rally; None where there is no match around the rally.
        history: ``[B, 4]`` int32 catalogue index of the last strokes of the rally, the incoming one first, n for none; None where
            only the state is known.
        number: ``[B]`` int32 number of the stroke in the rally, from 1; None where only the state is known.
        own: ``[B]`` catalogue index of the striker's own last stroke, n for none.
        incoming: ``[B]`` catalogue index of the incoming stroke, n for none: the striker serves.
        contact: ``[B]`` contact offered: 0 below, 1 above the net.
        duel: ``[B]`` net shots in a row that end with the incoming stroke; 3: three or more.
        effort: ``[B]`` the striker's effort: own attacking strokes so far in the rally.
        opponent_effort: ``[B]`` the same of the receiver.
        hurried: ``[B]`` whether the striker is hurried, 0 or 1.
        mask: ``[B, n]`` legal strokes.
    """

    game: Game
    state: I32
    score: I16 | None = None
    history: I32 | None = None
    number: I32 | None = None

    def __post_init__(self) -> None:
        # Copies that cannot be written to: a policy must not reach into the matches that it plays.
        for name in ("state", "score", "history", "number"):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(np.asarray(given)))

    def __len__(self) -> int:
        return len(self.state)

    own = functools.cached_property[I32](lambda self: frozen(self.game.own(self.state)))
    incoming = functools.cached_property[I32](lambda self: frozen(self.game.incoming(self.state)))
    contact = functools.cached_property[I32](lambda self: frozen(self.game.contact(self.state)))
    duel = functools.cached_property[I32](lambda self: frozen(self.game.duel(self.state)))
    effort = functools.cached_property[I32](lambda self: frozen(self.game.effort(self.state)))
    opponent_effort = functools.cached_property[I32](lambda self: frozen(self.game.opponent_effort(self.state)))
    hurried = functools.cached_property[I32](lambda self: frozen(self.game.hurried(self.state)))
    mask = functools.cached_property[Bools](lambda self: frozen(self.game.mask(self.state)))


def stages_of(number: Ints | None, points: Ints | None) -> dict[str, I64]:
    """``[B]`` stage of each of :data:`STAGES` that is known.

    Args:
        number: ``[B]`` number of a stroke in its rally: ``length`` is 0 from stroke 19 on, 1 from stroke 27 on, -1 before.
        points: ``[B, 2]`` points of both players before the rally: ``end`` is 0 where both have 19 or more, of 21, and else -1.
    """
    stages: dict[str, I64] = {}
    if number is not None:
        stages["length"] = np.asarray(np.searchsorted(_LONG, number, side="right") - 1)
    if points is not None:
        stages["end"] = np.where((np.asarray(points) >= BWF.points - 2).all(axis=1), 0, -1)
    return stages


@runtime_checkable
class Policy(Protocol):
    """Contract of every player.

    A policy that reads ``states.score`` must say so with ``reads_score = True``, one that reads ``states.history`` or
    ``states.number`` with ``reads_history = True``; the latter may read the score too where there is one. In the game with
    recovery, a policy waits where people do unless it has a method ``positions(states)``, the :class:`Waits` contract.
    """

    def probabilities(self, states: States) -> Floats:
        """``[B, n]`` probability of each stroke of the catalogue; zero for illegal strokes, each row sums to 1."""
        ...


@runtime_checkable
class Waits(Protocol):
    """Contract of players who choose positions in the game with recovery."""

    def positions(self, states: States) -> Floats:
        """``[B, 9]`` probability of each position where the opponent is in each state; zero where it is not feasible."""
        ...


def reads_score(policy: Policy) -> bool:
    """Whether a policy reads the score of the match, so that it cannot be tabulated. Raises PolicyError: asking it raised."""
    with _blamed(f"reads_score of {type(policy).__name__} raised"):
        return bool(getattr(policy, "reads_score", False))


def reads_history(policy: Policy) -> bool:
    """Whether a policy reads the rally so far, so it plays only stroke by stroke. Raises PolicyError: asking it raised."""
    with _blamed(f"reads_history of {type(policy).__name__} raised"):
        return bool(getattr(policy, "reads_history", False))


@contextlib.contextmanager
def _blamed(what: str) -> Iterator[None]:
    """Turn what a policy raises into a PolicyError."""
    try:
        yield
    except (KeyboardInterrupt, PolicyError):
        raise
    except BaseException as error:  # sys.exit too: no policy ends the program
        raise PolicyError(f"{what} {described(error)}") from error


def called(policy: Policy) -> str:
    """A policy in an error: by the name that it was resolved from, else by its class."""
    name = policy.name if isinstance(policy, GamePolicy) else ""
    return f"policy {(name or type(policy).__name__)!r}"


def checked_probabilities(policy: Policy, states: States) -> F64:
    """Call a policy and check what it returns.

    Raises:
        HistoryError: the policy reads the rally so far, which is not known here.
        PolicyError: the policy raised, or a row is no distribution over the legal strokes; says which state and stroke.
    """
    if states.history is None and reads_history(policy):
        where = "where a match is played stroke by stroke (live court, simulated matches, Gymnasium opponents)"
        why = f"reads the strokes of the rally so far, so it has no table over states and plays only {where}"
        raise HistoryError(f"{called(policy)} {why}; use a policy of the state here, such as bc")
    return _checked(policy.probabilities, called(policy), states, states.game.mask(states.state), "stroke")


def checked_positions(policy: Policy, states: States) -> F64:
    """``[B, 9]`` positions of a policy, of people if it has none. Raises PolicyError: it raised, or a row is no distribution."""
    people = states.game.people_positions(states.state)
    return _checked(policy.positions, called(policy), states, people > 0, "position") if isinstance(policy, Waits) else people


def _checked(ask: Callable[[States], object], who: str, states: States, legal: Bools, what: str) -> F64:
    """Ask a policy and check that its answer is a distribution over legal strokes, or positions, in every row."""
    with _blamed(f"{who} raised"):
        raw = ask(states)
    try:
        found = np.asarray(raw)
        if found.dtype.kind not in "fiub":
            raise TypeError(f"numbers of type {found.dtype}")
        with np.errstate(over="ignore"):
            p = found.astype(np.float64)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise PolicyError(f"{who} returned {type(raw).__name__}, no array of real numbers") from error
    if p.shape != legal.shape:
        raise PolicyError(f"{who} returned shape {p.shape}, expected {legal.shape}")

    def refuse(bad: Bools, says: Callable[[int], str]) -> None:
        if bad.any():
            row = int(bad.argmax())
            raise PolicyError(f"{who} {says(row)} in state: {states.game.describe(int(states.state[row]))}")

    refuse(np.asarray(~np.isfinite(p).all(axis=1)), lambda _: "returned NaN or infinity")
    illegal, names = (p != 0) & ~legal, states.game.catalogue.names if what == "stroke" else POSITIONS
    first = illegal.argmax(axis=1)
    refuse(
        np.asarray(illegal.any(axis=1)),
        lambda i: f"plays the illegal {what} {names[first[i]]} with probability {p[i, first[i]]:g}",
    )
    wrong = np.asarray((p < 0).any(axis=1) | (np.abs(p.sum(axis=1) - 1) > 1e-4))
    refuse(wrong, lambda i: f"returned no distribution (sum {p[i].sum():g}, least {p[i].min():g})")
    return p


def drawn_strokes(p: F64, draw: Ints) -> Intp:
    """``[B]`` catalogue index of the stroke that each row of ``[B, n]`` probabilities plays.

    Args:
        p: rows that sum to about 1.
        draw: ``[B]`` uniform integers in [0, 65535); cumulative probabilities are rounded to 1/65535 as in a table.
    """
    return chosen(cumulative_positions(p), draw)


Observation = npt.ArrayLike | Mapping[str, npt.ArrayLike]
"""Observation of the environments: a vector, or a dictionary with the keys ``observation`` and ``action_mask``."""


def act(policy: Policy, game: Game, observation: Observation, mask: npt.ArrayLike | None, rng: Generator) -> int | Intp:
    """Draw an action for an observation of the environments.

    Args:
        observation: ``[60]`` of ``rally_v0``, ``[66]`` of ``match_v0`` (played by BWF rules), or a batch of them; one number more
            in the game with recovery.
        mask: ``[n]`` or ``[B, n]`` allowed actions; None: that of the dictionary, or all legal ones.

    Returns:
        Catalogue index of a stroke, or n + position, or ``[B]`` of them for a batch.

    Raises:
        GameError: an observation is of no state of the game in which the player is to act.
        PolicyError: the policy fails, or gives no probability to an allowed action.
    """
    if isinstance(observation, Mapping):
        mask = observation["action_mask"] if mask is None else mask
        observation = observation["observation"]
    seen = np.asarray(observation, dtype=np.float64)
    rows = np.atleast_2d(seen)
    end = rows.shape[1] - game.hides
    rows, waits = rows[:, :end], (rows[:, end:] == 1).any(axis=1)
    if waits.any():
        # A receiver sees the state of the striker from the other side, and so the score.
        sides = np.r_[SWAP, np.arange(RALLY_WIDTH, rows.shape[1])]
        if rows.shape[1] > RALLY_WIDTH:
            sides[RALLY_WIDTH : RALLY_WIDTH + 4] = RALLY_WIDTH + np.array([1, 0, 3, 2])
        rows = np.where(waits[:, None], rows[:, sides], rows)
    score = None
    if rows.shape[1] > RALLY_WIDTH:
        score = np.rint(rows[:, RALLY_WIDTH : RALLY_WIDTH + 4] * [BWF.cap, BWF.cap, BWF.games, BWF.games]).astype(np.int16)
    states = States(game=game, state=states_of(game, rows), score=score)
    p = checked_probabilities(policy, states)
    if waits.any():
        p = np.hstack([np.where(waits[:, None], 0, p), np.where(waits[:, None], checked_positions(policy, states), 0)])
    p = np.pad(p, ((0, 0), (0, game.n_actions - p.shape[1])))
    if mask is not None:
        p = p * np.asarray(mask, dtype=bool)
    total = np.cumsum(p, axis=1)
    if (total[:, -1] <= 0).any():
        raise PolicyError(f"{called(policy)} plays none of the allowed strokes")
    # `<=`, so that a draw of 0 does not choose a first stroke of probability 0.
    actions = (total <= rng.random((len(p), 1)) * total[:, -1:]).sum(axis=1)
    return int(actions[0]) if seen.ndim == 1 else actions


@dataclasses.dataclass(frozen=True, eq=False)
class GamePolicy:
    """A policy on one game, which can act in its environments."""

    policy: Policy  # the policy; its other attributes are available here too
    game: Game  # the tables
    name: str = ""  # by which it was resolved; empty for none

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in ("policy", "game", "name"):  # while it is copied or unpickled
            raise AttributeError(name)
        return getattr(self.policy, name)

    def probabilities(self, states: States) -> Floats:
        """``[B, n]`` probabilities of the policy."""
        return self.policy.probabilities(states)

    def positions(self, states: States) -> F64:
        """``[B, 9]`` probabilities of the positions of the policy, those of people if it has none."""
        return checked_positions(self.policy, states)

    def act(self, observation: Observation, mask: npt.ArrayLike | None = None, rng: Generator | None = None) -> int | Intp:
        """Draw an action for an observation, see :func:`act`; without ``rng``, from fresh entropy."""
        return act(self.policy, self.game, observation, mask, np.random.default_rng(rng))


class UniformPolicy:
    """Uniform random policy: every legal stroke is as likely as any other. The baseline of all others."""

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` one over the number of legal strokes."""
        mask = states.mask
        p: F64 = mask / mask.sum(axis=1, keepdims=True)
        return p


@dataclasses.dataclass(frozen=True, eq=False)
class TemperedPolicy:
    """Probabilities of ``base`` raised to 1 / temperature and normalised; temperature 0 plays the likeliest stroke.

    Positions, in the game with recovery, stay those of ``base``.

    Of several likeliest strokes, temperature 0 plays the one that comes first in the catalogue. A stroke that the base
    never plays is never played.

    Attributes:
        base: the policy that is sharpened (temperature below 1) or flattened (above 1).
        temperature: finite and not negative.
    """

    base: Policy
    temperature: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.temperature) and self.temperature >= 0):
            raise PolicyError(f"temperature {self.temperature!r}: expected a finite number, 0 (greedy) or above")

    @property
    def reads_score(self) -> bool:
        """Whether the base reads the score."""
        return reads_score(self.base)

    @property
    def reads_history(self) -> bool:
        """Whether the base reads the rally so far."""
        return reads_history(self.base)

    def positions(self, states: States) -> F64:
        """``[B, 9]`` positions of the base."""
        return checked_positions(self.base, states)

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` tempered probabilities. Raises PolicyError: the base returned no distribution over the legal strokes."""
        p = checked_probabilities(self.base, states)
        best = p.max(axis=1, keepdims=True)
        if self.temperature == 0:
            greedy = np.zeros_like(p)
            greedy[np.arange(len(p)), p.argmax(axis=1)] = 1.0
            return greedy
        with np.errstate(under="ignore"):
            weight = (p / best) ** (1 / self.temperature)  # the best stroke keeps weight 1, so nothing overflows
        tempered: F64 = weight / weight.sum(axis=1, keepdims=True)
        return tempered


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TabulatedPolicy:
    """A policy on every state of one game.

    Attributes:
        game: the game it was compiled for.
        cumulative: ``[P]`` uint16, probability of the legal strokes of a state up to and including this one, in units of
            1/65535; draws choose from it by :func:`shuttle_marl.game.draws.chosen`.
        waits: ``[S, 9]`` uint16, the same for the positions up to and including each one where the opponent is in each state;
            None: as people.
    """

    game: Game
    cumulative: U16
    waits: U16 | None = None

    def __repr__(self) -> str:
        return f"TabulatedPolicy(hash={self.hash[:12]!r}, game={self.game!r})"

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 of the tables, hexadecimal."""
        return content_hash(b"".join(part.tobytes() for part in self._arrays().values()))

    def pair_probabilities(self) -> F64:
        """``[P]`` probability of each legal pair given its state, exactly as it is played from the table."""
        return np.concatenate([self.block_probabilities(block) for block in range(self.game.n_blocks)])

    def position_probabilities(self) -> F64:
        """``[S, 9]`` probability of each position where the opponent is in each state."""
        return position_shares(self.waiting_table)

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
        return position_shares(self.waiting_table[states.state])

    def waiting_at(self, positions: F64 | None) -> "TabulatedPolicy":
        """The same strokes, and ``[S, 9]`` positions; None: as before."""
        return self if positions is None else dataclasses.replace(self, waits=_own(cumulative_positions(positions), self.game))

    def choose_position(self, state: Ints, draw: Ints) -> Intp:
        """``[B]`` position against each state, by draws of :func:`shuttle_marl.game.draws.position_draw`."""
        return chosen(self.waiting_table[state], draw)

    @property
    def waiting_table(self) -> U16:
        """``[S, 9]`` cumulative probabilities of positions: ``waits``, or those of people."""
        return _people_table(self.game) if self.waits is None else self.waits

    def act(self, observation: Observation, mask: npt.ArrayLike | None = None, rng: Generator | None = None) -> int | Intp:
        """Draw a stroke for an observation, see :func:`shuttle_marl.game.policy.act`; without ``rng``, from fresh entropy."""
        return act(self, self.game, observation, mask, np.random.default_rng(rng))

    def choose(self, state: Ints, draw: Ints) -> Intp:
        """``[B]`` which of its legal strokes each state plays, by draws of :func:`shuttle_marl.game.draws.choice_draw`."""
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
            if waits.shape != (game.n_states, N_POSITIONS) or waits.dtype != np.uint16 or (waits[:, -1] != CHOICE_ONE).any():
                raise PolicyError(f"{where}: no table of nine positions in the {game.n_states:,} states of this game")
            steps = np.diff(waits.astype(np.int32), axis=1, prepend=0)
            infeasible = np.tile(~game.waiting.mask(np.arange(game.n_base_states)), (game.n_blocks, 1))
            if (steps < 0).any() or steps[infeasible].any():
                raise PolicyError(f"{where}: a position that is not feasible, or a cumulative probability that falls")
        return cls(game=game, cumulative=cumulative, waits=waits)

    @classmethod
    def load(cls, path: Path, game: Game) -> "TabulatedPolicy":
        """Read a table written by :meth:`save`. Raises PolicyError: the file is missing or damaged, or is for another game."""
        try:
            header, arrays = read_tensors(path)
            cumulative, waits = arrays["cumulative"], arrays.get("waits")
        except (OSError, KeyError, ValueError) as error:
            raise PolicyError(f"{path}: no readable table of a policy ({error})") from error
        if header.get("game") != game.hash:
            found = f"{path}: the policy was tabulated for game {str(header.get('game'))[:12]}"
            raise PolicyError(f"{found}, this is {game.hash[:12]}; tabulate it again")
        table = cls.checked(cumulative, game, str(path), waits=waits)
        if header.get("hash") != table.hash:
            raise PolicyError(f"{path}: the table does not match its hash; the file is damaged, save the policy again")
        return table


def tabulate(policy: Policy, game: Game) -> TabulatedPolicy:
    """Evaluate a policy on every state. Raises PolicyError: it reads more, raises, or gives no distribution over legal ones."""
    if isinstance(policy, TabulatedPolicy) and policy.game.hash == game.hash:
        return policy
    if reads_score(policy):
        raise PolicyError(f"{called(policy)} reads the score, so it has no table over states; a league plays it")
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
    people, who = game.people_positions(states), called(policy)
    parts = zip(np.array_split(states, 16), np.array_split(people > 0, 16), strict=True)
    found = [_checked(policy.positions, who, States(game=game, state=part), legal, "position") for part, legal in parts]
    return _own(cumulative_positions(np.concatenate(found)), game)


@functools.lru_cache(maxsize=4)
def _people_table(game: Game) -> U16:
    """``[S, 9]`` cumulative probabilities of people's positions."""
    return frozen(cumulative_positions(game.people_positions(np.arange(game.n_states))))


def _own(table: U16, game: Game) -> U16 | None:
    """Cumulative probabilities of positions, None for those of people: the only ones where receivers have no choice."""
    return None if np.array_equal(table, _people_table(game)) else table


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
        PolicyError: another number of them, a negative one, or those of a state do not add up to 1.
    """
    if np.shape(p) != (game.n_pairs,) or not (np.asarray(p) >= -SUM_TOLERANCE).all():
        raise PolicyError(f"expected {game.n_pairs} probabilities, one for each legal pair, none negative")
    # One block after the other: a policy that does not look at the efforts has the same table in all of them.
    blocks = [_cumulative(game, p[game.block_pairs(block)]) for block in range(game.n_blocks)]
    return TabulatedPolicy(game=game, cumulative=np.concatenate(blocks))


def _cumulative(game: Game, p: Floats) -> U16:
    """``[base pairs]`` cumulative probabilities of one block of states, in units of 1/65535."""
    total = np.r_[0.0, np.cumsum(p, dtype=np.float64)]
    probability = total[1:] - total[game.base_pair_start[game.base_pair_state]]
    sums = probability[game.base_pair_start[game.base_pair_state + 1] - 1]
    if len(off := np.flatnonzero(~(np.abs(sums - 1) <= SUM_TOLERANCE))):
        state = game.describe(int(game.base_pair_state[off[0]]))
        raise PolicyError(f"probabilities sum to {sums[off[0]]:g}, not 1, in state: {state}")
    probability /= sums
    return np.asarray(np.rint(probability * CHOICE_ONE).astype(np.uint16))
