"""Variants of a game: the same strokes and rules, other probabilities, stored as small steps from the tables of a model.

For every base pair a variant says by how many steps of :data:`STEP` the log-odds of five probabilities differ from those of
the model: of a fault, of a winner given a good stroke, of a return from below given a return, and of a hurried receiver given a
return from below and from above. I8 are 8-bit numbers.
They are applied in whole numbers, with multipliers that are exact by definition, so a variant has the same tables, and the
same hash, on every machine.
"""

import functools
import json
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I8, I32, U64, Intp
from shuttle_marl.base.tensor_files import Tensors, packed_bytes, parsed, tensor_bytes, unpacked_bytes
from shuttle_marl.game.tables import HURRY_ONE, Game, GameError
from shuttle_marl.game.thresholds import ONE, Odds, moved_share, odds_of_steps

STEP: Final = 0.0625
"""Difference of log-odds of one step."""
COARSE: Final = 4
"""Steps of refits are multiples of this: their sampling errors are about five steps, and coarse steps take half the space."""
MOST_STEPS: Final = 127
"""Maximum size of a difference in steps."""
_RARE: Final = 0.006
_SLACK: Final = 1e-6


@functools.cache
def _multipliers() -> Odds:
    """``[256]`` each, by a step as an unsigned byte: what the odds are multiplied and divided by, in units of 1/65536."""
    return odds_of_steps(np.maximum(np.arange(256, dtype=np.uint8).view(np.int8).astype(np.int64), -MOST_STEPS), step=STEP)


def _shares(game: Game) -> tuple[tuple[U64, U64], ...]:
    """Part and whole of the five probabilities: fault, winner of good, from below of returned, hurried of each contact."""
    fault, winner, below = game.threshold.T.astype(np.uint64)
    hurry = game.hurry.T.astype(np.uint64)
    one, known = np.uint64(ONE), np.full_like(fault, HURRY_ONE)
    ends = (fault, np.full_like(fault, one)), (winner - fault, one - fault), (below - winner, one - winner)
    return *ends, (hurry[0], known), (hurry[1], known)


def moved(game: Game, steps: I8, fault_odds: I32 | None = None) -> Game:
    """A game of the same layout whose log-odds differ by steps.

    Args:
        steps: ``[5, base pairs]`` of fault, winner given a good stroke, from below given a return, and hurried from below and
            above.
        fault_odds: ``[L]`` odds of a fault by effort; default as before.
    """
    up, down = (table[steps.view(np.uint8)] for table in _multipliers())
    return with_odds(game, up, down, fault_odds)


def with_odds(game: Game, up: U64, down: U64, fault_odds: I32 | None = None) -> Game:
    """A game of the same layout with other odds.

    Args:
        up, down: ``[5, base pairs]`` what the odds of fault, winner given a good stroke, from below given a return, and hurried
            from below and above are multiplied and divided by, as :func:`odds_of_steps` gives them; ``[3, base pairs]`` keep the
            last two.
        fault_odds: ``[L]`` odds of a fault by effort; default as before.
    """
    faults, winners, belows, *hurried = _shares(game)
    one, most = np.uint64(ONE), np.uint64(ONE - 1)
    fault = np.minimum(moved_share(*faults, up[0], down[0], ONE), most)
    winner = np.minimum(fault + moved_share(*winners, up[1], down[1], one - fault), most)
    below = np.minimum(winner + moved_share(*belows, up[2], down[2], one - winner), most)
    table = np.stack([fault, winner, below], axis=1).astype(np.uint16)
    # The chance of a hurried receiver stays below 1, which 8 bits cannot hold.
    most = np.uint64(HURRY_ONE - 1)
    moved_by = zip(hurried, up[3:], down[3:], strict=False)
    hurry = [np.minimum(moved_share(part, whole, by, under, whole), most) for (part, whole), by, under in moved_by]
    return replace(
        game,
        threshold=table,
        hurry=np.stack(hurry, axis=1).astype(np.uint8) if hurry else game.hurry,
        fault_odds=game.fault_odds if fault_odds is None else fault_odds,
    )


def steps_between(game: Game, other: Game, unit: int = 1) -> I8:
    """``[5, base pairs]`` steps that lead from a game to another one of the same layout, in multiples of ``unit``.

    To the nearest multiple; of faults and winners upwards where they end few rallies, so that every stroke still ends as many.
    """
    parts = zip(_shares(game), _shares(other), strict=True)
    steps = np.stack([(_log_odds(*after) - _log_odds(*before)) / (unit * STEP) for before, after in parts])
    rare = other.threshold[:, 1] < _RARE * ONE
    steps[:2, rare] = np.ceil(steps[:2, rare] - _SLACK)
    most = MOST_STEPS // unit
    return (unit * np.clip(np.rint(steps), -most, most)).astype(np.int8)


def _log_odds(part: U64, whole: U64) -> F64:
    # Half a unit on either side: a probability that was rounded to 0 or 1 is finite.
    return np.asarray(np.log(part + 0.5) - np.log((whole - part) + 0.5))


def _order(game: Game) -> Intp:
    """Order of the base pairs in a file: by the edge that follows, because the same answer differs alike and packs well."""
    return np.argsort(game.base_pair_edge, kind="stable")


def packed(game: Game, others: Mapping[str, Game], *, coarse: Collection[str] = ()) -> bytes:
    """Content of a file of variants (safetensors).

    Args:
        others: variants by name, of the same layout; their nearest steps are stored.
        coarse: names of variants that are stored in multiples of :data:`COARSE` steps.
    """
    order = _order(game)
    arrays: dict[str, npt.NDArray[Any]] = {}
    hashes = {}
    for name, other in others.items():
        steps = steps_between(game, other, COARSE if name in coarse else 1)
        arrays[f"{name}.steps"] = packed_bytes(steps[:, order])
        arrays[f"{name}.fault_odds"] = other.fault_odds
        hashes[name] = moved(game, steps, other.fault_odds).hash
    return tensor_bytes(arrays, {"variants": json.dumps({"game": game.hash, "hashes": hashes})})


def hashes_of(tensors: Tensors) -> dict[str, str]:
    """Hash of each variant in a file, by name.

    Raises:
        KeyError, ValueError: it is no file of variants.
    """
    hashes = parsed(tensors.metadata["variants"])["hashes"]
    if not isinstance(hashes, dict) or not all(isinstance(value, str) for value in hashes.values()):
        raise ValueError("the variants are no table of names and hashes")
    return hashes


def unpacked(tensors: Tensors, game: Game, name: str) -> Game:
    """One variant from a file.

    Args:
        name: of the variant, one of :func:`hashes_of`.

    Raises:
        KeyError, TypeError, ValueError: it is no file of variants of this game.
        GameError: its tables form no game.
    """
    if parsed(tensors.metadata["variants"])["game"] != game.hash:
        raise ValueError("its variants are of another game")
    steps = np.empty((5, game.n_base_pairs), dtype=np.int8)
    steps[:, _order(game)] = unpacked_bytes(tensors.arrays[f"{name}.steps"], np.int8, steps.shape)
    variant = moved(game, steps, np.ascontiguousarray(tensors.arrays[f"{name}.fault_odds"]))
    if variant.hash != hashes_of(tensors)[name]:
        raise GameError(f"variant {name} does not match its hash")
    return variant
