"""Opponents of ``adapt``: a known population, which methods are given, and hidden ones, generated from a seed.

Players are divided into three parts: clones of the first are known, the others belong to the dev and to the test population. Each
opponent is drawn from the seed of its split, its family and its number alone. The seed of the test split is public, so that
everyone can verify; that of the hidden splits, of this task and of others, is drawn by a public beacon later, because a public
seed can be enumerated.
"""

import functools
import hashlib
import re
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.exact import best_response
from shuttle_marl.game.court import BACK, third_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.policy import baselines
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.task import Arena

FAMILIES: Final = ("synthetic", "human", "counter", "mixture", "switcher")
"""Families of opponents; all but ``control`` count in the score."""
CONTROL: Final = "control"
"""Clones of players, against whom a best response to bc is almost optimal already."""
ADAPT_RALLIES: Final = 500
BEACON: Final = "https://api.drand.sh/52db9ba70e0cc0f6eaf7803dd07447a1f5477735fd3f661792ba94600c84e971/public"
"""Public beacon of randomness: the chain ``quicknet`` of drand, a round every 3 seconds."""
HIDDEN_ROUND: Final = 39_668_212
"""Round whose randomness is the seed of the hidden split: that of 1 June 2027, 00:00 UTC."""
_STYLES: Final = ("attacking", "defensive", "safe", "bc@0.5", "random")
_TILTS: Final = (-1.0, 1.0)
_TOLERANCE: Final = 1e-6


def checked_beacon(randomness: str | None) -> str:
    """The seed of the hidden split.

    The package cannot check it, because it opens no connection. Scores depend on it, so a wrong one is found by verification.

    Raises:
        SuiteError: it is missing, or is not 64 hexadecimal digits.
    """
    if randomness is None or re.fullmatch("[0-9a-f]{64}", randomness) is None:
        raise SuiteError(
            f"the hidden split needs --beacon with the 64 hexadecimal digits of `randomness` in {BEACON}/{HIDDEN_ROUND}, "
            "which appears on 1 June 2027"
        )
    return randomness


class Opponent(NamedTuple):
    """An opponent: policies and the rallies in which they start, from 0."""

    policies: tuple[TabulatedPolicy, ...]
    starts: tuple[int, ...] = (0,)

    def at(self, rally: int) -> TabulatedPolicy:
        """What is played in a rally."""
        return [policy for policy, start in zip(self.policies, self.starts, strict=True) if start <= rally][-1]


@functools.lru_cache(maxsize=2)
def known(arena: Arena) -> dict[str, TabulatedPolicy]:
    """The known population by name: bc, a third of the clones, styles, human-like play, and tilts of bc."""
    names = ["bc", *(f"bc:{player}" for player in _players(arena, 0)), "attacking", "defensive", "safe", "bc@0.5", "human:0.05"]
    found = {name: arena.policy(name) for name in names}
    for kind, feature in _features(arena.game).items():
        for size in _TILTS:
            found[f"{kind}{size:+g}"] = tilted(arena, size * feature)
    return found


def opponent(arena: Arena, family: str, number: int) -> Opponent:
    """An opponent of the split."""
    if family != "switcher":
        return Opponent((_policy(arena, family, number),))
    rng = _rng(arena, family, number)
    first, second = rng.choice(len(FAMILIES) - 1, 2, replace=False)
    # Numbers from 1000 on are of no other opponent.
    pieces = tuple(_policy(arena, FAMILIES[kind], 1000 + number) for kind in (first, second))
    return Opponent(pieces, (0, int(rng.integers(100, 401))))


@functools.lru_cache(maxsize=16)
def _policy(arena: Arena, family: str, number: int) -> TabulatedPolicy:
    rng = _rng(arena, family, number)
    players = _players(arena, 1 if arena.split == "dev" else 2)
    if family == "synthetic":
        return tilted(arena, _shift(arena, rng))
    if family == "human":
        return arena.policy(f"human:{np.exp(rng.uniform(np.log(0.03), np.log(0.15))):.4f}:{players[rng.integers(len(players))]}")
    if family == "counter":
        answer = best_response(tilted(arena, _shift(arena, rng)), tolerance=_TOLERANCE).policy
        counter = best_response(answer, tolerance=_TOLERANCE).policy
        return mixture(arena.game, [arena.policy("bc"), counter], [1 - (weight := rng.uniform(0.2, 0.9)), weight])
    if family == "mixture":
        chosen = rng.choice(len(_STYLES), 3, replace=False)
        return mixture(arena.game, [arena.policy(_STYLES[i]) for i in chosen], rng.dirichlet(np.ones(3)))
    return arena.policy(f"bc:{players[number % len(players)]}")


def _players(arena: Arena, part: int) -> list[str]:
    found = baselines.players(arena.game)
    return found[part::3] or found


def _rng(arena: Arena, family: str, number: int) -> np.random.Generator:
    return rng_of("adapt-v0", arena.split, arena.beacon, f"{family} {number}")


def rng_of(name: str, split: Split, beacon: str | None, words: str) -> np.random.Generator:
    """Random numbers of a split: those of the hidden one follow from the beacon."""
    seed = beacon if split == "hidden" else f"{name} {split}"
    digest = hashlib.sha256(f"{seed} {words}".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "big"))


def mixture(game: Game, policies: Sequence[TabulatedPolicy], weights: Sequence[float] | F64) -> TabulatedPolicy:
    """The policy that draws one of several for every stroke."""
    parts = [weight * policy.pair_probabilities() for weight, policy in zip(weights, policies, strict=True)]
    return from_pair_probabilities(game, np.sum(parts, axis=0))


def tilted(arena: Arena, shift: F64) -> TabulatedPolicy:
    """The imitated average player with ``[base pairs]`` added to its log-probabilities."""
    game = arena.game
    weight = baselines.probabilities(None, game) * np.exp(shift)
    chance = weight / np.bincount(game.base_pair_state, weight, game.n_base_states)[game.base_pair_state]
    return from_pair_probabilities(game, np.tile(chance, game.n_blocks))


def _shift(arena: Arena, rng: np.random.Generator) -> F64:
    """``[base pairs]`` a random shift: in the parametrisation of the clones, or of the dev split by areas."""
    game, sigma = arena.game, rng.uniform(1.0, 1.5)
    catalogue, stroke, state = game.catalogue, game.base_pair_stroke, game.base_pair_state
    shot, technique, area = catalogue.shot[stroke], catalogue.technique[stroke], catalogue.area[stroke]
    incoming, contact = game.incoming(state), game.contact(state)
    if arena.split == "dev":
        came = np.append(catalogue.area, catalogue.area.max() + 1)[incoming]
        return np.asarray(
            sigma * (rng.normal(size=(10, 2, 9))[came, contact, area] + rng.normal(size=(2, 13))[contact, shot]) / 2**0.5
        )
    came = np.append(catalogue.shot, catalogue.shot.max() + 1)[incoming]
    style, places = rng.normal(size=(14, 2, 13, 3)), rng.normal(size=(13, 3, 9))
    return np.asarray(sigma * (style[came, contact, shot, technique] + places[shot, technique, area]) / 2**0.5)


def _features(game: Game) -> dict[str, F64]:
    """``[base pairs]`` features of the known tilts, each about of size 1."""
    stroke = game.base_pair_stroke
    area, attack = game.catalogue.area[stroke], game.catalogue.is_attack[stroke]
    fault = game.outcome_probabilities(slice(0, game.n_base_pairs))[:, 0]
    return {
        "net": (third_of(area) == 0).astype(np.float64),
        "deep": (third_of(area) == BACK).astype(np.float64),
        "attack": attack.astype(np.float64),
        "side": (area % 3 != 1).astype(np.float64),
        "risk": np.clip(fault / 0.1, 0, 3),
    }
