"""Trained agents as folders: the network, its table on every state, and a model card. Played from the table, without torch.

``table.safetensors`` is the policy on one game (its hash is inside), ``network.safetensors`` the weights behind it, and
``card.json`` says how it was trained, how good it is, and the hashes of all three files.
"""

import hashlib
from pathlib import Path
from typing import Any, Final

from shuttle_marl.files import FileReadError, open_file, problem, read_sealed, replace_file, seal
from shuttle_marl.game.policy import Policy, PolicyError
from shuttle_marl.game.rally import Game
from shuttle_marl.game.shipped import folder_of, model_folder
from shuttle_marl.game.table import TabulatedPolicy

TABLE: Final = "table.safetensors"
NETWORK: Final = "network.safetensors"
CARD: Final = "card.json"
ALGORITHMS: Final = ("ppo", "a2c", "sac")
"""First parts of the names of shipped agents."""
AGENTS: Final = "agents"
"""Folder of the agents in the folder of a model."""


def save_agent(folder: Path, table: TabulatedPolicy, network: bytes, card: dict[str, Any]) -> None:
    """Write an agent's folder; the model card last, so that a folder with one is whole.

    Args:
        folder: made if it is not there.
        table: the agent on every state.
        network: content of ``network.safetensors``.
        card: fields of the model card; the hashes are added.
    """
    table.save(folder / TABLE)
    replace_file(folder / NETWORK, network)
    hashes = {name: _hash(folder / name) for name in (TABLE, NETWORK)}
    content = {"game": table.game.hash, "catalogue": table.game.catalogue.version, "sha256": hashes, **card}
    replace_file(folder / CARD, seal(content))


def load_agent(folder: Path, game: Game) -> TabulatedPolicy:
    """Read an agent's policy.

    Raises:
        PolicyError: the folder holds no agent, a damaged one, or one trained on another game.
    """
    card = read_card(folder)
    if card.get("game") != game.hash:
        other = "" if card.get("catalogue") == game.catalogue.version else ", whose strokes are not these"
        raise PolicyError(
            f"{folder}: this agent was trained on game {str(card.get('game'))[:12]}{other}; this is {game.hash[:12]}. "
            "Train it again, or play on its game with --game"
        )
    hashes = card.get("sha256")
    for name in (TABLE, NETWORK):  # never a name that the card gives
        if not isinstance(hashes, dict) or hashes.get(name) != _hash(folder / name):
            raise PolicyError(f"{folder / name}: does not fit its hash in {CARD}; the file is damaged or was replaced")
    return TabulatedPolicy.load(folder / TABLE, game)


def read_card(folder: Path) -> dict[str, Any]:
    """The model card of an agent.

    Raises:
        PolicyError: it is missing or damaged.
    """
    try:
        return read_sealed(folder / CARD)
    except FileReadError as error:
        reason = f"{CARD}: {error}"
        raise PolicyError(f"{folder}: no trained agent ({reason}); `python -m shuttle_marl.training` writes one") from error


def _hash(path: Path) -> str:
    try:
        with open_file(path) as file:
            return hashlib.sha256(file.read()).hexdigest()
    except (OSError, ValueError) as error:
        raise PolicyError(f"{path}: cannot be read ({problem(error)}); the agent is not whole") from error


def shipped_folder(name: str, model: Path) -> Path:
    """The folder of the agent of a name such as ``ppo`` or ``ppo:attacking`` in the folder of a model."""
    return model / AGENTS / name.replace(":", "-")


def load_shipped(key: str, argument: str | None, game: Game) -> Policy:
    """The agent of a name such as ``ppo`` or ``ppo:attacking`` that came with the model of a game.

    Raises:
        PolicyError: there is none, or it is damaged.
    """
    name = key if argument is None else f"{key}:{argument}"
    model = folder_of(game)
    known = [] if model is None else installed(key, model)
    if model is None or name not in known:
        raise PolicyError(
            f"no policy {name!r}: the trained agents of this game are {', '.join(known) or 'none of that algorithm'}; "
            "train one and name it agent:FOLDER"
        )
    return load_agent(shipped_folder(name, model), game)


def load_folder(argument: str | None, game: Game) -> Policy:
    """The agent in a folder, for names such as ``agent:FOLDER``.

    Raises:
        PolicyError: the folder holds no agent, a damaged one, or one trained on another game.
    """
    if not argument:
        raise PolicyError("policy agent: expected the folder of a trained agent behind a colon, as in agent:runs/ppo-0/agent")
    return load_agent(Path(argument), game)


def installed(key: str, model: Path | None = None) -> list[str]:
    """Names of the agents of an algorithm that a model comes with; None: the default model."""
    model = model or model_folder()
    folders = sorted(path.parent.name for path in (model / AGENTS).glob(f"*/{CARD}"))
    return [folder.replace("-", ":", 1) for folder in folders if folder.partition("-")[0] == key]
