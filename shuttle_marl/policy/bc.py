"""Behaviour-cloned players: the average player, and single players as a tilt of it. Runs without torch.

The model says for every state how likely the average player chooses each shot type and technique, and aims at each area;
a player's own model adds shifts to these logits, shrunk towards none (:mod:`shuttle_marl.dynamics.players`). As a policy
it is restricted to the legal strokes.
"""

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open

from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.rally import Game
from shuttle_marl.game.shipped import BC, folder_of, model_folder
from shuttle_marl.game.table import TabulatedPolicy, from_pair_probabilities


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class BehaviourClones:
    """The behaviour-cloned players of one game.

    Attributes:
        log_choice: ``[P]`` log-probability of each legal pair for the average player, before dividing by the legal total.
        players: M identifiers.
        style: ``[M, 15, 2, 13, 3]`` shifts by incoming shot type, contact, shot type and technique.
        area: ``[M, 13, 3, 9]`` shifts by shot type, technique and target.
    """

    log_choice: npt.NDArray[np.float32]
    players: tuple[str, ...]
    style: npt.NDArray[np.float64]
    area: npt.NDArray[np.float64]

    def pair_probabilities(self, game: Game, player: str | None) -> npt.NDArray[np.float64]:
        """``[P]`` probability of each legal pair in its state."""
        logit = self.log_choice.astype(np.float64)
        if player is not None:
            m = self.players.index(player)
            stroke, catalogue = game.pair_stroke, game.catalogue
            shot, technique, area = catalogue.shot[stroke], catalogue.technique[stroke], catalogue.area[stroke]
            # 13 stands for "no stroke yet", as in the models.
            incoming = np.append(catalogue.shot, len(self.area[m])).astype(np.int64)[game.edge_incoming[game.pair_state >> 1]]
            logit = logit + self.style[m, incoming, game.pair_state & 1, shot, technique] + self.area[m, shot, technique, area]
        probability = np.exp(logit)
        return np.asarray(probability / np.bincount(game.pair_state, probability, game.n_states)[game.pair_state])


@functools.cache
def clones(folder: Path) -> BehaviourClones:
    """Read the players of a model folder.

    Raises:
        PolicyError: the file is missing or damaged.
    """
    path = folder / BC
    try:
        with safe_open(path, framework="numpy") as file:
            header = file.metadata() or {}
            return BehaviourClones(
                log_choice=file.get_tensor("log_choice"),
                players=tuple(json.loads(header["players"])),
                style=file.get_tensor("style"),
                area=file.get_tensor("area"),
            )
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise PolicyError(f"{path}: no readable behaviour-cloned players ({error}); fit or install the model again") from error


def installed() -> bool:
    """Whether the shipped model has behaviour-cloned players."""
    return (model_folder() / BC).is_file()


def players() -> list[str]:
    """Identifiers of the players of the shipped model that have a model of their own, most strokes first."""
    return list(clones(model_folder()).players)


def load(player: str | None, game: Game) -> TabulatedPolicy:
    """The average player (None), or one by identifier, as a table.

    Raises:
        PolicyError: no such player, or the game is of no known model.
    """
    folder = folder_of(game)
    if folder is None:
        raise PolicyError("behaviour-cloned players belong to a model; this game was not loaded from one")
    known = clones(folder)
    if player is not None and player not in known.players:
        raise PolicyError(f"no model of the player {player!r}; there are: {', '.join(known.players)}")
    return from_pair_probabilities(game, known.pair_probabilities(game, player))
