"""The rally as pure functions for JAX, bit-equal to the kernel: to be jitted, mapped by ``jax.vmap``, or run on an accelerator.

``pip install jax``. The functions are of one rally and play both seats: a stroke gives the state of the next striker.
"""

from typing import NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from shuttle_marl.game.layout import SWAP_TOKENS
from shuttle_marl.game.recovery import CENTRE, N_POSITIONS
from shuttle_marl.game.rules import RETURNED_BELOW, WINNER
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.tables import ROOT, Game


class Places(NamedTuple):
    """Positions of receivers, see :class:`shuttle_marl.game.recovery.Waiting`."""

    start: jax.Array
    choices: jax.Array
    place: jax.Array  # [base states, n + 9] number of each action among the feasible positions, else -1


class Tables(NamedTuple):
    """The arrays of a game, a tree of JAX; see :class:`shuttle_marl.game.tables.Game`.

    In the game with recovery thresholds and chances are those by position, with ``places``. Then ``reply_rank`` has n + 9 columns
    too, so that a mask is one row of either: XLA joins parts slowly.
    """

    limits: jax.Array
    hurry: jax.Array
    base_pair_start: jax.Array
    first_reply: jax.Array
    reply_edge: jax.Array
    reply_rank: jax.Array
    edge_own: jax.Array
    edge_incoming: jax.Array
    edge_duel: jax.Array
    edge_attack: jax.Array
    places: Places | None = None

    @classmethod
    def of(cls, game: Game | None = None) -> Self:
        """The arrays of a game, the shipped one by default.

        Raises:
            GameError: it is the game of a pair, whose seats have tables of their own; take ``game.seats[0]``.
        """
        game = game or default_game()
        waiting, wide = game.waiting, game.n_actions - game.n_strokes
        arrays = {name: getattr(game, name) for name in cls._fields if name != "places"}
        arrays |= {"limits": waiting.limits, "hurry": waiting.hurry}
        arrays["reply_rank"] = np.pad(game.reply_rank, ((0, 0), (0, 0), (0, wide)), constant_values=-1)
        places = None
        if game.hides:
            place = np.pad(waiting.place, ((0, 0), (game.n_strokes, 0)), constant_values=-1)
            places = Places(*map(jnp.asarray, (waiting.start.astype(np.int32), waiting.choices, place)))
        return cls(**{name: jnp.asarray(array) for name, array in arrays.items()}, places=places)


class Step(NamedTuple):
    """What a stroke leads to."""

    state: jax.Array  # int32, state of the receiver, who is the next striker; at the end of a rally that of the next serve
    reward: jax.Array  # float32 of the striker: 1 for a winner, -1 for a fault, else 0. The receiver's is its negative
    terminated: jax.Array  # bool, whether the rally is over


def init() -> jax.Array:
    """The state of the server."""
    return jnp.asarray(ROOT, jnp.int32)


def observe(tables: Tables, state: jax.Array, waits: jax.Array | bool = False) -> tuple[jax.Array, jax.Array]:
    """What the striker sees.

    Args:
        waits: in the game with recovery, whether the receiver looks, who is to choose a position.

    Returns:
        ``[7]`` int32 observation, see :meth:`shuttle_marl.game.layout.Layout.observation`, and ``[n]`` bool, which strokes are
        legal; with recovery ``[8]``, the last number ``waits``, and ``[n + 9]`` legal actions.
    """
    block, base = jnp.divmod(state, len(tables.base_pair_start) - 1)
    own_effort, opponent_effort = jnp.divmod(block, len(tables.limits))
    edge, contact, hurried = base >> 2, state & 1, state >> 1 & 1
    own, incoming, duel = tables.edge_own[edge], tables.edge_incoming[edge], tables.edge_duel[edge]
    seen = jnp.stack([own, incoming, contact, duel, own_effort, opponent_effort, hurried])
    rank = tables.reply_rank[incoming, contact]
    if tables.places is None:
        return seen, rank >= 0
    waits = jnp.asarray(waits)
    seen = jnp.append(jnp.where(waits, seen[SWAP_TOKENS], seen), waits.astype(seen.dtype))
    return seen, jnp.where(waits, tables.places.place[base], rank) >= 0


def draws(key: jax.Array, shape: tuple[int, ...] = ()) -> jax.Array:
    """Uniform int32 in [0, 2^24), which decide strokes."""
    return (jax.random.bits(key, shape, jnp.uint32) >> 8).astype(jnp.int32)


def step(tables: Tables, state: jax.Array, stroke: jax.Array, draw: jax.Array, position: jax.Array | int = CENTRE) -> Step:
    """Play a stroke: the rule of :func:`shuttle_marl.game.rules.outcome` and :func:`~shuttle_marl.game.rules.next_state`.

    Args:
        state: int32, state of the striker.
        stroke: int32, catalogue index; one that is not legal loses the rally.
        draw: int32, see :func:`draws`.
        position: int32, position of the receiver, who loses with one that is not feasible; not read in the game without recovery.
    """
    levels, n_states = len(tables.limits), len(tables.base_pair_start) - 1
    block, base = jnp.divmod(state, n_states)
    own, other = jnp.divmod(block, levels)
    rank = tables.reply_rank[tables.edge_incoming[base >> 2], state & 1, stroke].astype(jnp.int32)
    illegal, won = (rank < 0) | (stroke < 0) | (stroke >= tables.reply_rank.shape[0] - 1), jnp.asarray(False)
    k = jnp.maximum(rank, 0)  # JAX reads another entry where an index is out of bounds
    pair, edge = tables.base_pair_start[base] + k, tables.reply_edge[tables.first_reply[base] + k]
    if tables.places is not None:
        place = tables.places.place[base, position - N_POSITIONS]
        won = (place < 0) | (position < 0) | (position >= N_POSITIONS)  # the position is chosen before the stroke
        pair = tables.places.start[base] + k * tables.places.choices[base] + jnp.maximum(place, 0)
    outcome = (draw & 0xFFFF >= tables.limits[own, pair]).sum(dtype=jnp.int32)
    contact = outcome - RETURNED_BELOW
    over = (contact < 0) | illegal | won
    hurried = draw >> 16 < tables.hurry[pair, jnp.maximum(contact, 0)]
    after = other * levels + jnp.minimum(own + tables.edge_attack[edge], levels - 1)
    following = after * n_states + 4 * edge + 2 * hurried + contact
    scored = won | (outcome == WINNER) & ~illegal
    reward = jnp.where(over, jnp.where(scored, 1.0, -1.0), 0.0)
    return Step(jnp.where(over, ROOT, following).astype(jnp.int32), reward, over)
