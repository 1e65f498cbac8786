"""Finds the models that come with the package."""

import functools
from pathlib import Path
from typing import Final

from shuttle_marl.rally import Game, GameError

_MODELS: Final = Path(__file__).parent.parent / "models"


def model_folder(name: str = "default") -> Path:
    """Folder of a shipped model, or of the model in the folder ``name``.

    Raises:
        GameError: there is no such model.
    """
    for folder in (_MODELS / name, Path(name)):
        if (folder / "game.safetensors").is_file():
            return folder
    shipped = ", ".join(sorted(p.parent.name for p in _MODELS.glob("*/game.safetensors"))) or "none"
    raise GameError(
        f"no model {name!r}: neither shipped (there: {shipped}) nor a folder with game.safetensors; "
        "fit one with `python -m shuttle_marl.dynamics fit`"
    )


@functools.cache
def default_game() -> Game:
    """The benchmark's game: the symmetric average profile, as shipped."""
    return Game.load(model_folder() / "game.safetensors")
