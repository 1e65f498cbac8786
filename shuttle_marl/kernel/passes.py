"""One stroke in a block of rows, as passes that each do one thing.

A stroke reads tables at two places that nobody can foresee, and each of them may be far from the processor. So a pass is a
tight loop over all rows of a block: the reads of many rows are then under way at once, and arithmetic is done for several
rows in one instruction. A loop that did everything for one row after the other takes twice as long.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.kernel.core import draw, inlined, outcome_of

BLOCK: Final = 256
"""Rows of a block: few enough that what one pass leaves is in the first cache for the next."""


class Block(NamedTuple):
    """What the passes leave for each other, ``[BLOCK]`` each.

    Attributes:
        bits: uint64 draw of the stroke.
        pair: int32 legal pair that is played.
        edge: int32 edge that follows it.
        limits: uint64 thresholds of the pair.
        outcome: int64 outcome, 0 to 3.
        listed: int64 rows that are to be looked at once more.
    """

    bits: npt.NDArray[np.uint64]
    pair: npt.NDArray[np.int32]
    edge: npt.NDArray[np.int32]
    limits: npt.NDArray[np.uint64]
    outcome: npt.NDArray[np.int64]
    listed: npt.NDArray[np.int64]


@inlined
def new_block() -> Any:
    """Room for a block."""
    return Block(
        np.empty(BLOCK, np.uint64),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK, np.uint64),
        np.empty(BLOCK, np.int64),
        np.empty(BLOCK, np.int64),
    )


@inlined
def draw_strokes(part: Any, bits: Any) -> None:
    """Write the draw of the stroke that is due in each row of a part."""
    for j in range(part.key.size):
        bits[j] = draw(part.key[j], part.stroke[j])


@inlined
def find_pair(tables: Any, block: Any, j: Any, s: Any, k: Any) -> None:
    """Note that the k-th legal stroke of state s is played."""
    # An index without a sign need not be checked for counting from the end.
    at = np.uint64(s)
    block.pair[j] = tables.head[at, 0] + k
    block.edge[j] = tables.head[at, 2] + k


@inlined
def read_limits(tables: Any, block: Any, count: Any) -> None:
    """Read the thresholds of the pairs that are played."""
    for j in range(count):
        block.limits[j] = tables.limits[np.uint64(block.pair[j])]


@inlined
def next_state(edge: Any, outcome: Any) -> Any:
    """State of who strikes next; where the rally is over, the state after its last stroke, contact below."""
    return 2 * edge + max(outcome - 2, 0)


@inlined
def play(part: Any, block: Any) -> None:
    """Decide the stroke of every row of a part, and go on to the next."""
    for j in range(part.state.size):
        outcome = outcome_of(block.limits[j], block.bits[j])
        block.outcome[j] = outcome
        part.state[j] = next_state(block.edge[j], outcome)
        part.stroke[j] += 1
        part.striker[j] ^= 1


@inlined
def strike(tables: Any, part: Any, rank: Any, block: Any) -> None:
    """Play, in every row of a part, the legal stroke whose rank is given."""
    draw_strokes(part, block.bits)
    for j in range(rank.size):
        find_pair(tables, block, j, part.state[j], rank[j])
    read_limits(tables, block, rank.size)
    play(part, block)


@inlined
def list_where(block: Any, count: Any, over: Any) -> Any:
    """List the rows whose rally is over, or those whose rally goes on; returns their number."""
    listed = 0
    for j in range(count):
        block.listed[listed] = j
        listed += (block.outcome[j] < 2) == over
    return listed
