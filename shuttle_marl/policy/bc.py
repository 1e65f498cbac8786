"""Behaviour-cloned players: the average player, and individual players as shifts of its logits. Runs without torch.

The model predicts the shot type, technique and target area of the average player in every state; the model of a player adds
shrunken shifts to these logits (:mod:`shuttle_marl.dynamics.players`). As policies, both are restricted to the legal strokes.
"""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F32, F64
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.shipped import BC, PROFILES, folder_of, origin_of, read_model
from shuttle_marl.game.stroke import HEIGHTS, N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import Game, GameError
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.tensor_files import checked, parsed


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class BehaviourClones:
    """The behaviour-cloned players of one game.

    Attributes:
        log_choice: ``[base pairs]`` unnormalised log-probability of each base pair for the average player.
        profiles: the same for the average player of each discipline, by name (:data:`~shuttle_marl.game.shipped.PROFILES`).
        players: M identifiers.
        style: ``[M, 15, 2, 13, 3]`` shifts by incoming shot type, contact, shot type and technique.
        area: ``[M, 13, 3, 9]`` shifts by shot type, technique and target.
    """

    log_choice: F32
    profiles: dict[str, npt.NDArray[np.float16]]
    players: tuple[str, ...]
    style: F64
    area: F64

    def pair_probabilities(self, game: Game, player: str | None, profile: str | None = None) -> F64:
        """``[base pairs]`` probability of each base pair in its state, which does not depend on the efforts.

        Args:
            game: the game.
            player: identifier; None: the average player.
            profile: discipline of the average player; None, or a discipline without one: the average of both.
        """
        logit = self.profiles.get(profile or "", self.log_choice).astype(np.float64)
        if player is not None:
            m = self.players.index(player)
            stroke, catalogue, state = game.base_pair_stroke, game.catalogue, game.base_pair_state
            shot, technique, area = catalogue.shot[stroke], catalogue.technique[stroke], catalogue.area[stroke]
            # 13 means "no stroke yet", as in the models.
            incoming = np.append(catalogue.shot, len(self.area[m])).astype(np.int64)[game.incoming(state)]
            logit = logit + self.style[m, incoming, game.contact(state), shot, technique] + self.area[m, shot, technique, area]
        weight = np.exp(logit)
        return np.asarray(weight / np.bincount(game.base_pair_state, weight, game.n_base_states)[game.base_pair_state])


@functools.cache
def clones(folder: Path) -> BehaviourClones:
    """Read the players of a model folder.

    Raises:
        PolicyError: the file is missing or damaged.
    """
    path = folder / BC
    try:
        header, arrays = read_model(folder, BC)
        players = parsed(header["players"])
        if not isinstance(players, list) or not all(isinstance(player, str) for player in players):
            raise ValueError("the players are not a list of names")
        m = len(players)
        pairs = arrays["log_choice"].shape[:1]
        of_profiles = {name: f"log_choice.{name}" for name in PROFILES}
        return BehaviourClones(
            log_choice=checked(arrays["log_choice"], np.float32, pairs),
            profiles={name: checked(arrays[key], np.float16, pairs) for name, key in of_profiles.items() if key in arrays},
            players=tuple(players),
            style=checked(arrays["style"], np.float64, (m, N_SHOTS + 2, len(HEIGHTS), N_SHOTS, N_TECHNIQUES)),
            area=checked(arrays["area"], np.float64, (m, N_SHOTS, N_TECHNIQUES, N_AREAS)),
        )
    except GameError as error:
        raise PolicyError(str(error)) from error
    except (OSError, KeyError, ValueError) as error:
        raise PolicyError(f"{path}: no readable behaviour-cloned players ({error}); fit or install the model again") from error


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
        PolicyError: there is no such player, or the game was not loaded from a model.
    """
    origin = origin_of(game)
    if origin is None:
        raise PolicyError("behaviour-cloned players belong to a model; this game was not loaded from one")
    known = clones(origin.folder)
    if known.log_choice.shape != (game.n_base_pairs,):
        raise PolicyError(f"{origin.folder / BC}: its players are not of the game beside it; fit or install the model again")
    if player is not None and player not in known.players:
        raise PolicyError(f"no model of the player {player!r}; there are: {', '.join(known.players)}")
    return known.pair_probabilities(game, player, origin.variant)


@functools.lru_cache(maxsize=8)
def load(player: str | None, game: Game) -> TabulatedPolicy:
    """The average player (None) or an individual as a table.

    Raises:
        PolicyError: as :func:`probabilities`.
    """
    return from_pair_probabilities(game, np.tile(probabilities(player, game), game.n_blocks))
