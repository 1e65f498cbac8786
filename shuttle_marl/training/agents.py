"""Trained agents as folders: the network, its table on every state, and a card. Played from the table, without torch.

``table.safetensors`` is the policy on one game (its hash is inside), ``network.safetensors`` the weights behind it, and
``card.json`` says how it was trained, how good it is, and the hashes of both files.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from shuttle_marl.dynamics.shipped import folder_of
from shuttle_marl.files import replace_file
from shuttle_marl.policy.base import Policy, PolicyError
from shuttle_marl.policy.registry import Family
from shuttle_marl.policy.table import TabulatedPolicy
from shuttle_marl.rally import Game

TABLE: Final = "table.safetensors"
NETWORK: Final = "network.safetensors"
CARD: Final = "card.json"
AGENTS: Final = "agents"
"""Folder of the agents in the folder of a model."""


def save_agent(folder: Path, table: TabulatedPolicy, network: bytes, card: dict[str, Any]) -> None:
    """Write an agent's folder; the card last, so that a folder with a card is whole.

    Args:
        folder: made if it is not there.
        table: the agent on every state.
        network: content of ``network.safetensors``.
        card: what is known about it; the hashes are added.
    """
    table.save(folder / TABLE)
    replace_file(folder / NETWORK, network)
    hashes = {name: _hash(folder / name) for name in (TABLE, NETWORK)}
    content = {"game": table.game.hash, "catalogue": table.game.catalogue.version, "sha256": hashes, **card}
    replace_file(folder / CARD, (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode())


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
    if card.get("sha256", {}).get(TABLE) != _hash(folder / TABLE):
        raise PolicyError(f"{folder / TABLE}: does not fit its hash in {CARD}; the file is damaged or was replaced")
    return TabulatedPolicy.load(folder / TABLE, game)


def read_card(folder: Path) -> dict[str, Any]:
    """The card of an agent.

    Raises:
        PolicyError: it is missing or damaged.
    """
    try:
        card = json.loads((folder / CARD).read_text(encoding="utf-8"))
        if isinstance(card, dict):
            return card
        problem = "no object"
    except (OSError, ValueError) as error:
        problem = str(error)
    raise PolicyError(f"{folder}: no trained agent ({problem}); `python -m shuttle_marl.training` writes one")


def _hash(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise PolicyError(f"{path}: cannot be read ({error.strerror}); the agent is not whole") from error


def shipped_folder(name: str, model: Path) -> Path:
    """Where the agent of a name such as ``ppo`` or ``ppo:attacking`` lies in the folder of a model."""
    return model / AGENTS / name.replace(":", "-")


def _load_shipped(key: str, argument: str | None, game: Game) -> Policy:
    name = key if argument is None else f"{key}:{argument}"
    model = folder_of(game)
    if argument == "" or model is None or not (shipped_folder(name, model) / CARD).is_file():
        known = "" if model is None else ", ".join(_installed(key, model))
        raise PolicyError(
            f"no policy {name!r}: the trained agents of this game are {known or 'none of that algorithm'}; "
            "train one and name it agent:FOLDER"
        )
    return load_agent(shipped_folder(name, model), game)


def _load_folder(argument: str | None, game: Game) -> Policy:
    if not argument:
        raise PolicyError("policy agent: expected the folder of a trained agent behind a colon, as in agent:runs/ppo-0/agent")
    return load_agent(Path(argument), game)


def _installed(key: str, model: Path) -> list[str]:
    """Names of the agents of an algorithm that a model comes with."""
    folders = sorted(path.parent.name for path in (model / AGENTS).glob(f"*/{CARD}"))
    return [folder.replace("-", ":", 1) for folder in folders if folder.partition("-")[0] == key]


def _family(key: str) -> Family:
    def names() -> list[str]:
        from shuttle_marl.dynamics.shipped import model_folder  # noqa: PLC0415  finds files; only when names are listed

        return _installed(key, model_folder())

    return Family(load=lambda argument, game: _load_shipped(key, argument, game), names=names)


PPO_FAMILY: Final = _family("ppo")
A2C_FAMILY: Final = _family("a2c")
SAC_FAMILY: Final = _family("sac")
AGENT_FAMILY: Final = Family(load=_load_folder, names=lambda: ())
