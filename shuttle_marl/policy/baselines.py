"""Baseline policies: behaviour-cloned players, and scripted styles. Runs without torch.

The behaviour-cloning model predicts the shot type, technique and target area of the average player in every state; the model of a
player adds shrunken shifts to these logits (:mod:`shuttle_marl.dynamics.choices`). As policies, both are restricted to the legal
strokes.

``bc:history`` is the average player who remembers the rally, for simulated matches that look real. A state holds the incoming
stroke and the striker's own last one. People also remember the two strokes before, attack less in long rallies, and lift less at
the end of close games. Attributes of these strokes, the number of the stroke and, in a match, the score shift the
log-probabilities of ``bc``: of a shot type and technique, and of an area given those. The policy is no stronger opponent than
``bc`` and forecasts no better. It is no function of the state, so it has no table.

Scripted styles play the softmax of points: a stroke with one more point is played e (2.7) times as often. Their rules depend on
shot types, target areas, contact, incoming shot, and the position of the opponent, who struck where one's own last stroke landed.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, F64, I16, I32
from shuttle_marl.base.files import parsed
from shuttle_marl.base.tensor_files import Tensors, checked
from shuttle_marl.game.court import BACK, N_AREAS, area_centre, mirrored, third_of
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.pairs import people_of
from shuttle_marl.game.policy import LAGS, STAGES, PolicyError, States, TabulatedPolicy, from_pair_probabilities, stages_of
from shuttle_marl.game.shipped import (
    BC,
    CHOICE_UNITS,
    HISTORY,
    OPPOSITE,
    PROFILES,
    folder_of,
    hands_of_variant,
    load_game,
    origin_of,
    readable,
)
from shuttle_marl.game.stroke import HEIGHTS, N_SHOTS, N_TECHNIQUES, SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.plain_network import legal_softmax

REMEMBERING: Final = "bc:history"  # name of the average player who remembers the rally
N_STYLES: Final = N_SHOTS * N_TECHNIQUES  # pairs of shot type and technique
ATTRIBUTES: Final = {"shot": N_SHOTS, "area": N_AREAS, "technique": N_TECHNIQUES}
"""Attributes of a remembered stroke, and their numbers of values; one more value stands for no stroke."""
_WIDTH: Final = N_STYLES + N_AREAS
_FIRST_LAG: Final = 2  # first column of States.history that the state does not hold


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class BehaviourClones:
    """The behaviour-cloned players of one game.

    Attributes:
        log_choice: ``[base pairs]`` unnormalised log-probability of each base pair for the average player.
        profiles: the same for the average player of each discipline, by name (:data:`~shuttle_marl.game.shipped.PROFILES`).
        opposite: the same in the game of players with different hands.
        players: M identifiers.
        style: ``[M, 15, 2, 13, 3]`` shifts by incoming shot type, contact, shot type and technique.
        area: ``[M, 13, 3, 9]`` shifts by shot type, technique and target, in the frame of a right-handed striker.
    """

    log_choice: F32
    profiles: dict[str, F32]
    opposite: F32
    players: tuple[str, ...]
    style: F64
    area: F64

    def pair_probabilities(self, game: Game, player: str | None, variant: str | None = None) -> F64:
        """``[base pairs]`` probability of each base pair in its state, which does not depend on the efforts.

        Args:
            player: identifier; None: the average player.
            variant: of the game; one without an average player: that of the game itself.
        """
        discipline, opposite = hands_of_variant(variant)
        logit = self.profiles.get(discipline or "", self.log_choice).astype(np.float64)
        if opposite:
            same = game.counterparts(load_game(str(folder_of(game))))
            logit = self.opposite.astype(np.float64) + np.where(same < 0, 0.0, (logit - self.log_choice)[same])
        if player is not None:
            m = self.players.index(player)
            stroke, catalogue, state = game.base_pair_stroke, game.catalogue, game.base_pair_state
            shot, technique = catalogue.shot[stroke], catalogue.technique[stroke]
            area = mirrored(catalogue.area)[stroke] if opposite else catalogue.area[stroke]
            style = self.style[m, game.incoming_shot(state), game.contact(state), shot, technique]
            logit = logit + style + self.area[m, shot, technique, area]
        weight = np.exp(logit)
        return np.asarray(weight / np.bincount(game.base_pair_state, weight, game.n_base_states)[game.base_pair_state])


@functools.cache
def clones(folder: Path) -> BehaviourClones:
    """Read the players of a model folder.

    Raises:
        PolicyError: the file is missing or damaged.
    """
    with _readable(folder, BC, "behaviour-cloned players") as (header, arrays):
        players = parsed(header["players"])
        if not isinstance(players, list) or not all(isinstance(player, str) for player in players):
            raise ValueError("the players are not a list of names")
        m = len(players)
        choice, pairs = arrays["choice"], arrays["choice"].shape[:1]
        shifts = {name: arrays[f"choice.{name}"] for name in PROFILES if f"choice.{name}" in arrays}
        return BehaviourClones(
            log_choice=_log(checked(choice, np.int16, pairs)),
            profiles={name: _log(choice + checked(shift, np.int16, pairs)) for name, shift in shifts.items()},
            opposite=_log(checked(arrays[f"choice.{OPPOSITE}"], np.int16, arrays[f"choice.{OPPOSITE}"].shape[:1])),
            players=tuple(players),
            style=checked(arrays["style"], np.float64, (m, N_SHOTS + 2, len(HEIGHTS), N_SHOTS, N_TECHNIQUES)),
            area=checked(arrays["area"], np.float64, (m, N_SHOTS, N_TECHNIQUES, N_AREAS)),
        )


@contextlib.contextmanager
def _readable(folder: Path, name: str, what: str) -> Iterator[Tensors]:
    try:
        with readable(folder, name, what, PolicyError) as tensors:
            yield tensors
    except GameError as error:  # of the model card
        raise PolicyError(str(error)) from error


def _log(units: I16) -> F32:
    return (units / CHOICE_UNITS).astype(np.float32)


def known_for(game: Game) -> bool:
    """Whether the model of a game has behaviour-cloned players."""
    folder = folder_of(game)
    return folder is not None and (folder / BC).is_file()


def players(game: Game) -> list[str]:
    """Identifiers of the individual players of the model of a game, most strokes first; empty for other games."""
    folder = folder_of(game)
    return [] if folder is None else list(clones(folder).players)


def probabilities(player: str | None, game: Game) -> F64:
    """``[base pairs]`` positive probability of each legal pair, for the average player (None) or an individual.

    Raises:
        PolicyError: the player does not exist, or the game was not loaded from a model.
    """
    origin = origin_of(game)
    if origin is None:
        raise PolicyError("behaviour-cloned players belong to a model; this game was not loaded from one")
    known = clones(origin.folder)
    of_game = known.opposite if hands_of_variant(origin.variant)[1] else known.log_choice
    if of_game.shape != (game.n_base_pairs,):
        raise PolicyError(f"{origin.folder / BC}: its players are not of the game beside it; fit or install the model again")
    if player is not None and player not in known.players:
        raise PolicyError(f"no model of the player {player!r}; there are: {', '.join(known.players)}")
    return known.pair_probabilities(game, player, origin.variant)


def imitation(player: str, game: Game) -> str:
    """Name of the policy that imitates a player, or the average one where the model has no choices of the player."""
    return f"bc:{player}" if player in players(game) else "bc"


@functools.lru_cache(maxsize=32)
def load(player: str | None, game: Game) -> TabulatedPolicy:
    """The average player (None) or an individual as a table.

    Raises:
        PolicyError: as :func:`probabilities`.
    """
    if game.whole is not None:  # choices do not depend on skill, so all pairs share a table
        return dataclasses.replace(load(player, people_of(game).profile), game=game)
    return from_pair_probabilities(game, np.tile(probabilities(player, game), game.n_blocks))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class HistoryPolicy:
    """A player of the state whose log-probabilities are shifted by earlier strokes of the rally.

    Attributes:
        base: the player of the state.
        shifts: of each shot type and technique, and of each area: by attribute (:data:`ATTRIBUTES`)
            ``[2, values + 1, 39 + 9]`` by lag (3 and 4) and value; by kind of stage (:data:`~shuttle_marl.game.policy.STAGES`)
            ``[stages, 39 + 9]``.
    """

    base: TabulatedPolicy
    shifts: dict[str, F64]
    reads_history = True
    limits_itself = True

    @classmethod
    def of(cls, base: TabulatedPolicy, arrays: dict[str, npt.NDArray[Any]]) -> "HistoryPolicy":
        """A policy from the arrays of a file.

        Raises:
            KeyError, ValueError: an array is missing or invalid.
        """
        shapes: dict[str, tuple[int, ...]] = {name: (size, _WIDTH) for name, size in STAGES.items()}
        shapes |= {name: (LAGS - _FIRST_LAG, size + 1, _WIDTH) for name, size in ATTRIBUTES.items()}
        shifts = {name: checked(arrays[name], np.float16, shape).astype(np.float64) for name, shape in shapes.items()}
        return cls(base=base, shifts=shifts)

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probability of each stroke; see :class:`shuttle_marl.game.policy.Policy`.

        Raises:
            ValueError: the states have no history.
        """
        if states.history is None:
            raise ValueError("states without history")
        catalogue, p = states.game.catalogue, self.base.probabilities(states)
        factor = np.exp(self._shift(states, states.history[:, _FIRST_LAG:]))
        style, of_stroke = np.unique(catalogue.shot.astype(np.int64) * N_TECHNIQUES + catalogue.technique, return_inverse=True)
        order = np.argsort(of_stroke, kind="stable")
        start = np.searchsorted(of_stroke[order], np.arange(len(style)))
        # An area is chosen given shot type and technique: its shifts leave their probabilities as they are.
        q = p * factor.take(N_STYLES + catalogue.area, axis=1)
        before, after = (np.add.reduceat(x.take(order, axis=1), start, axis=1) for x in (p, q))
        factor = factor.take(style, axis=1) * np.divide(before, after, out=np.zeros_like(after), where=after > 0)
        q *= factor.take(of_stroke, axis=1)
        return np.asarray(q / q.sum(axis=1, keepdims=True))

    def _shift(self, states: States, strokes: I32) -> F64:
        lag, catalogue = np.arange(strokes.shape[1]), states.game.catalogue
        values = {name: np.append(getattr(catalogue, name), size)[strokes] for name, size in ATTRIBUTES.items()}
        shift = sum(self.shifts[name][lag, value].sum(axis=1) for name, value in values.items())
        stages = stages_of(states.number, None if states.score is None else states.score[:, :2])
        return np.asarray(shift + sum(np.pad(self.shifts[name], ((0, 1), (0, 0)))[stage] for name, stage in stages.items()))


def remembers(game: Game) -> bool:
    """Whether the model of a game knows choices by the rally so far."""
    folder = folder_of(game)
    return known_for(game) and folder is not None and (folder / HISTORY).is_file()


@functools.lru_cache(maxsize=8)
def load_remembering(game: Game) -> HistoryPolicy:
    """The average player of a game who remembers the rally.

    Raises:
        PolicyError: the model of the game has none, or its file is damaged.
    """
    base, folder = load(None, game), folder_of(game)
    if folder is None or not remembers(game):
        raise PolicyError(f"policy {REMEMBERING}: the model of this game has no {HISTORY}; fit the model again, or use bc")
    with _readable(folder, HISTORY, "choices") as tensors:
        return HistoryPolicy.of(base, tensors.arrays)


Rules = Callable[[States], F64]
"""Function from a batch of states to ``[B, n]`` points of every stroke; illegal strokes are masked afterwards."""

SERVE: Final = {"short-serve": 2.0, "long-serve": 0.0}  # a long serve can be smashed
# Attacking, contact above the net: hit down and hard; a clear loses the attack.
ATTACK_ABOVE: Final = {
    "smash": 4.0, "net-kill": 4.0, "half-smash": 3.0, "drop": 2.0, "push": 2.0, "drive": 1.5, "net-shot": 1.0,
    "cross-court-net-shot": 1.0, "block": 0.5, "clear": -1.0,
}  # fmt: skip
# Attacking, contact below the net: keep the shuttle flat or tight, so that the opponent has to lift.
ATTACK_BELOW: Final = {
    "net-shot": 2.5, "cross-court-net-shot": 2.5, "push": 2.0, "drive": 2.0, "block": 1.5, "drop": 1.0, "clear": -1.0,
    "lift": -1.0,
}  # fmt: skip
# Defensive: lift high and deep from below; soft strokes from above, except net kills; no risky angles at the net.
DEFEND: Final = {
    "short-serve": 2.0, "long-serve": 0.0, "net-kill": 4.0, "lift": 3.5, "drop": 1.5, "net-shot": 2.0, "half-smash": 2.0,
    "clear": 1.0, "block": 1.0, "push": 0.5, "drive": 0.0, "cross-court-net-shot": 0.0, "smash": 0.0,
}  # fmt: skip
DEFEND_AGAINST_SMASH: Final = {"lift": 2.0, "block": 1.0, "drive": -1.0}
"""Defensive, in addition, against a smash, half smash or net kill: lift to gain time, or absorb the pace."""
POWER: Final = ("smash", "half-smash", "net-kill")


@dataclasses.dataclass(frozen=True, eq=False)
class ScriptedPolicy:
    """Softmax over the points of each stroke."""

    points: Rules

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` softmax of the points over the legal strokes."""
        return legal_softmax(self.points(states), states.mask)


def attacking(states: States) -> F64:
    """Hit down from above, stay flat or tight from below, serve short, and send the opponent running.

    Each metre between the opponent and the target gives 0.5 points.
    """
    shot = states.game.catalogue.shot
    above = states.contact[:, None] == 1
    preference = np.where(above, _by_shot(ATTACK_ABOVE)[shot], _by_shot({**ATTACK_BELOW, **SERVE})[shot])
    return preference + 0.5 * distance_from_opponent(states)


def defensive(states: States) -> F64:
    """Play high and deep, absorb the smash, and aim at the centre so that the opponent gets no angle.

    A target off the centre line costs a point, and a lift, clear or long serve that is not deep costs 2 points.
    """
    catalogue = states.game.catalogue
    points = _by_shot(DEFEND)[catalogue.shot]
    points = points - (catalogue.area % 3 != 1)
    high = np.isin(catalogue.shot, [SHOTS.index(name) for name in ("lift", "clear", "long-serve")])
    points = points - 2.0 * (high & (third_of(catalogue.area) != BACK))
    smashed = np.isin(states.game.incoming_shot(states.state), [SHOTS.index(name) for name in POWER])
    return points + smashed[:, None] * _by_shot(DEFEND_AGAINST_SMASH)[catalogue.shot]


def safe(states: States) -> F64:
    """Keep the shuttle in play, and the opponent from hitting down.

    Each percentage point less of the probability of a fault gives 1 point, each one less of the probability that the opponent
    returns the shuttle from above the net 0.1, and each one of the probability that it is not returned at all 0.05. The
    probabilities are read from the game itself.
    """
    game = states.game
    row, pair = game.pairs(states.state)
    fault, winner, below = game.limits_of(pair).T.astype(np.float64) / ONE  # cumulative
    points = np.zeros((len(states), game.n_strokes))
    points[row, game.base_pair_stroke[pair % game.n_base_pairs]] = (
        100.0 * (1 - fault) - 10.0 * (1 - below) + 5.0 * (winner - fault)
    )
    return points


STYLES: Final[Mapping[str, Rules]] = {"attacking": attacking, "defensive": defensive, "safe": safe}
"""The rule sets by the name of the policy."""


def distance_from_opponent(states: States) -> F64:
    """``[B, n]`` metres between the opponent and the centre of each stroke's target area; 0 where no one has moved yet.

    The opponent is taken to stand at the centre of the area to which the striker's own last stroke went.
    """
    catalogue = states.game.catalogue
    target = area_centre(catalogue.area)
    between = np.linalg.norm(target[:, None] - target[None], axis=-1)
    return np.vstack([between, np.zeros(len(catalogue))])[states.own]


def _by_shot(points: Mapping[str, float]) -> F64:
    return np.array([points.get(name, 0.0) for name in SHOTS])
