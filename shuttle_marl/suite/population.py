"""Opponents of ``adapt`` and ``exploit``: a known population, which methods are given, and others, generated from a seed.

Players are divided into three parts: clones of the first are known, the others belong to the dev and to the other populations.
Each opponent is drawn from the seed of its split, its family and its number alone. The seeds of dev and test are public, so that
everyone can recompute scores, and so can be enumerated; whoever makes a round keeps its seed secret.
"""

import functools
import hashlib
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.exact import best_response
from shuttle_marl.game.court import BACK, third_of
from shuttle_marl.game.draws import stream
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.computed import best_response_policy, mixture
from shuttle_marl.suite.options import Split
from shuttle_marl.suite.tabular import normalised
from shuttle_marl.suite.task import Arena

FAMILIES: Final = ("synthetic", "waiting", "human", "counter", "mixture", "switcher", "learner")
"""Families of opponents; all but ``people`` count in the score, and ``waiting`` is of the game with recovery."""
PEOPLE: Final = "people"  # clones of players, against whom a best response to bc is almost optimal already
ADAPT_RALLIES: Final = 500
_STYLES: Final = ("attacking", "defensive", "safe", "bc@0.5", "random")
_TILTS: Final = (-1.0, 1.0)
_TOLERANCE: Final = 1e-6


def families(game: Game) -> tuple[str, ...]:
    """Families of opponents that a game has."""
    return tuple(name for name in FAMILIES if game.hides or name != "waiting")


class Opponent(NamedTuple):
    """An opponent: policies and the rallies in which they start, from 0."""

    policies: tuple[TabulatedPolicy, ...]
    starts: tuple[int, ...] = (0,)
    learns: float = 0.0  # probability with which each choice is that of the best response to what it met before the last change

    def at(self, rally: int, met: TabulatedPolicy | None = None) -> TabulatedPolicy:
        """What is played in a rally, after ``met`` was played before the last change; None: before any change."""
        policy = [policy for policy, start in zip(self.policies, self.starts, strict=True) if start <= rally][-1]
        if not self.learns or met is None:
            return policy
        return mixture([policy, best_response_policy(met)], [1 - self.learns, self.learns])


@functools.lru_cache(maxsize=2)
def known(arena: Arena) -> dict[str, TabulatedPolicy]:
    """The known population by name: bc, a third of the clones, styles, human-like play, tilts of bc, and habits of position."""
    names = ["bc", *(f"bc:{player}" for player in _players(arena, 0)), "attacking", "defensive", "safe", "bc@0.5", "human:0.05"]
    found = {name: arena.policy(name) for name in names}
    for kind, feature in _features(arena.game).items():
        for size in _TILTS:
            found[f"{kind}{size:+g}"] = tilted(arena, size * feature)
    place = np.arange(9)
    for kind, side in {"front": 1.0 - place // 3, "forehand": 1.0 - place % 3}.items():
        for size in _TILTS:
            found[f"{kind}{size:+g}"] = waiting(found["bc"], np.broadcast_to(size * side, (14, 9)))
    return found


def opponent(arena: Arena, family: str, number: int) -> Opponent:
    """An opponent of the split."""
    rng = rng_of("adapt-v1", arena.split, arena.seed, f"{family} {number}")
    if family == "learner":
        # Numbers from 1000 on are of no other opponent.
        return Opponent((_policy(arena, "mixture", 1500 + number),), learns=float(rng.uniform(0.3, 0.7)))
    if family != "switcher":
        return Opponent((_policy(arena, family, number),))
    kinds = [name for name in families(arena.game) if name not in ("switcher", "learner")]
    pieces = tuple(_policy(arena, kinds[kind], 1000 + number) for kind in rng.choice(len(kinds), 2, replace=False))
    return Opponent(pieces, (0, int(rng.integers(100, 401))))


@functools.lru_cache(maxsize=16)
def _policy(arena: Arena, family: str, number: int) -> TabulatedPolicy:
    rng = rng_of("adapt-v1", arena.split, arena.seed, f"{family} {number}")
    players = _players(arena, 1 if arena.split == "dev" else 2)
    if family == "synthetic":
        return tilted(arena, _shift(arena, rng))
    if family == "waiting":
        shift = rng.normal(scale=rng.uniform(1.5, 2.5), size=(14, 9))
        return waiting(arena.policy(f"bc:{players[number % len(players)]}"), shift)
    if family == "human":
        return arena.policy(f"human:{np.exp(rng.uniform(np.log(0.03), np.log(0.15))):.4f}:{players[rng.integers(len(players))]}")
    if family == "counter":
        answer = best_response(tilted(arena, _shift(arena, rng)), tolerance=_TOLERANCE).policy
        counter = best_response(answer, tolerance=_TOLERANCE).policy
        return mixture([arena.policy("bc"), counter], [1 - (weight := rng.uniform(0.2, 0.9)), weight])
    if family == "mixture":
        chosen = rng.choice(len(_STYLES), 3, replace=False)
        return mixture([arena.policy(_STYLES[i]) for i in chosen], rng.dirichlet(np.ones(3)))
    return arena.policy(f"bc:{players[number % len(players)]}")


def _players(arena: Arena, part: int) -> list[str]:
    found = baselines.players(arena.game)
    return found[part::3] or found


def rng_of(name: str, split: Split, seed: str | None, words: str) -> np.random.Generator:
    """Random numbers of a split: those of a round follow from its seed."""
    drawn_from = seed if split == "round" else f"{name} {split}"
    digest = hashlib.sha256(f"{drawn_from} {words}".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "big"))


def luck(split: Split, seed: str | None, *numbers: int) -> int:
    """Seed of rallies: who knows the draws learns far more from a rally, so those of a round follow from its seed."""
    if split == "round":
        return int(rng_of("luck", split, seed, repr(numbers)).integers(1 << 63))
    return int(stream(*numbers)[0] >> np.uint64(1))


def waiting(policy: TabulatedPolicy, shift: F64) -> TabulatedPolicy:
    """A policy with ``[14, 9]`` added to the log-probabilities of its positions, by the shot type played (the last: none)."""
    game = policy.game
    weight = policy.position_probabilities() * np.exp(shift)[game.incoming_shot(np.arange(game.n_states))]
    return policy.waiting_at(weight / weight.sum(axis=1, keepdims=True))


def tilted(arena: Arena, shift: F64) -> TabulatedPolicy:
    """The imitated average player with ``[base pairs]`` added to its log-probabilities."""
    game = arena.game
    chance = normalised(game, baselines.probabilities(None, game) * np.exp(shift))
    return from_pair_probabilities(game, np.tile(chance, game.n_blocks))


def _shift(arena: Arena, rng: np.random.Generator) -> F64:
    """``[base pairs]`` a random shift: in the parametrisation of the clones, or of the dev split by areas."""
    game, sigma = arena.game, rng.uniform(1.0, 1.5)
    catalogue, stroke, state = game.catalogue, game.base_pair_stroke, game.base_pair_state
    shot, technique, area = catalogue.shot[stroke], catalogue.technique[stroke], catalogue.area[stroke]
    incoming, contact = game.incoming(state), game.contact(state)
    if arena.split == "dev":
        came = np.append(catalogue.area, catalogue.area.max() + 1)[incoming]
        areas, shots = rng.normal(size=(10, 2, 9)), rng.normal(size=(2, 13))
        return np.asarray(sigma * (areas[came, contact, area] + shots[contact, shot]) / 2**0.5)
    came = game.incoming_shot(state)
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
