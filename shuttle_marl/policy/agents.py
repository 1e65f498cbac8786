"""Trained agents as folders with a network and a card, played from a table of the network without PyTorch.

``network.safetensors`` holds the weights; ``card.json`` holds the game, the training configuration, the evaluation, and the hash
of the weights. A table takes tens of megabytes, so it is computed when an agent is first played, and cached in the user's cache
folder; :mod:`shuttle_marl.policy.network` computes the same table on every machine.
"""

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy.typing as npt

from shuttle_marl.base.errors import command
from shuttle_marl.base.files import FileReadError, hash_in, problem, read_sealed, replace_with_card
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.game.pairs import trained_game, without_recovery, without_skill
from shuttle_marl.game.policy import Policy, PolicyError, TabulatedPolicy
from shuttle_marl.game.shipped import RECOVERY, folder_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.computed import cached_table

NETWORK: Final = "network.safetensors"
CARD: Final = "card.json"
ALGORITHMS: Final = ("ppo", "a2c", "sac")
AGENTS: Final = "agents"  # subfolder of a model with its agents


def save_agent(folder: Path, game: Game, network: bytes, card: dict[str, Any]) -> None:
    """Write the folder of an agent: the content of ``network.safetensors``, and a card, to which hashes are added."""
    fields = {"game": game.hash, "catalogue": game.catalogue.version, **card}
    replace_with_card(folder / CARD, fields, {NETWORK: network})


def load_agent(folder: Path, game: Game) -> TabulatedPolicy:
    """The table of an agent, from the cache or computed from its network.

    An agent that was trained on the game without recovery plays the one with it too, and waits as people do.

    Raises:
        PolicyError: the folder holds no agent, a damaged one, or one trained on another game.
    """
    card = read_card(folder)
    seat, trained, game = game, trained_game(game), without_skill(game)
    if card.get("game") == without_recovery(trained).hash:
        trained, game = without_recovery(trained), without_recovery(game)
    if card.get("game") != trained.hash:
        other = "" if card.get("catalogue") == game.catalogue.version else ", whose strokes are not these"
        raise PolicyError(
            f"{folder}: this agent was trained on game {str(card.get('game'))[:12]}{other}; this is {trained.hash[:12]}. "
            "Train it again, or play on its game with --game"
        )
    digest, weights = read_weights(folder, card)

    def evaluate() -> TabulatedPolicy:
        from shuttle_marl.policy.network import PolicyNetwork  # noqa: PLC0415  numba

        return PolicyNetwork.of_tensors(weights, game).table(game)

    return dataclasses.replace(cached_table(game, f"network {digest}", evaluate), game=seat)


def read_weights(folder: Path, card: dict[str, Any]) -> tuple[str, dict[str, npt.NDArray[Any]]]:
    """Hash and weights of the network of an agent.

    Raises:
        PolicyError: they are missing or damaged.
    """
    path = folder / NETWORK  # never a file name from the card
    try:
        digest = hash_in(card, NETWORK)
        return digest, read_tensors(path, digest).arrays
    except (OSError, ValueError) as error:
        raise PolicyError(f"{path}: cannot be used ({problem(error)}); the file is damaged or was replaced") from error


def read_card(folder: Path) -> dict[str, Any]:
    """Read the card of an agent.

    Raises:
        PolicyError: it is missing or damaged.
    """
    try:
        return read_sealed(folder / CARD)
    except FileReadError as error:
        reason = f"{CARD}: {error}"
        raise PolicyError(f"{folder}: no trained agent ({reason}); `{command('training')}` writes one") from error


def shipped_folder(name: str, model: Path) -> Path:
    """The folder of the agent of a name such as ``ppo`` or ``ppo:attacking`` in the folder of a model."""
    return model / AGENTS / name.replace(":", "-")


def load_shipped(key: str, argument: str | None, game: Game) -> Policy:
    """The shipped agent of a name such as ``ppo`` or ``ppo:attacking`` for a game.

    Raises:
        PolicyError: the agent does not exist, or it is damaged.
    """
    name, folders = key if argument is None else f"{key}:{argument}", _shipped(key, game)
    if name not in folders:
        known = ", ".join(installed(key, game)) or "none of that algorithm"
        raise PolicyError(f"no policy {name!r}: the trained agents of this game are {known}; train one and name it agent:FOLDER")
    return load_agent(folders[name], game)


def installed(key: str, game: Game) -> list[str]:
    """Names of the shipped agents of an algorithm that were trained on a game, and of damaged ones, which cannot be loaded."""
    folders = _shipped(key, game)
    trained = trained_game(game) if folders else game
    return [name for name, folder in folders.items() if _game_of(folder) in (None, trained.hash, without_recovery(trained).hash)]


def _game_of(folder: Path) -> str | None:
    """Hash of the game of an agent; None if its card is damaged."""
    try:
        return str(read_card(folder).get("game"))
    except PolicyError:
        return None


def about(name: str) -> str:
    """Description of a shipped agent, in one line."""
    key, _, style = name.partition(":")
    return f"agent trained with {key.upper()}" + (f", {style.replace('-', ' ')}" if style else "")


def _shipped(key: str, game: Game) -> dict[str, Path]:
    """Folders of the shipped agents of an algorithm, by name; those for the game with recovery first there."""
    model = folder_of(game)
    if model is None:
        return {}
    places = [model / AGENTS]
    if game.hides:
        places.append(model / AGENTS / RECOVERY)
    folders = [path.parent for place in places for path in sorted(place.glob(f"*/{CARD}"))]
    return {folder.name.replace("-", ":", 1): folder for folder in folders if folder.name.partition("-")[0] == key}
