"""Finds the models that come with the package, and reads their games."""

import functools
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.files import FileReadError, read_sealed
from shuttle_marl.game.rally import Game, GameError
from shuttle_marl.tensor_files import Tensors, checked, read_tensors

GAME: Final = "game.safetensors"
"""The compiled game in a model folder."""
BC: Final = "bc.safetensors"
"""Its behaviour-cloned players."""
NETWORKS: Final = "networks.safetensors"
"""The fitted models that the game was compiled from."""
SUPPORT: Final = "support.safetensors"
"""Data file beside the models: the torch reference of the tables needs it."""
VARIANTS: Final = "variants.safetensors"
"""Other games of its layout, among them refits on resampled matches."""
REFITS: Final = 8
"""Number of these refits; their names are those of the model with :1, :2, … behind."""
CARD: Final = "card.json"
"""The model card, which holds the hashes of the other files."""
_MODELS: Final = Path(__file__).parent.parent / "models"
_FOLDERS: dict[str, Path] = {}


def model_folder(name: str = "default") -> Path:
    """Folder of a shipped model, or of the model in the folder ``name``.

    Raises:
        GameError: there is no such model.
    """
    for folder in (_MODELS / name, Path(name)):
        if (folder / GAME).is_file():
            return folder
    shipped = ", ".join(sorted(p.parent.name for p in _MODELS.glob(f"*/{GAME}"))) or "none"
    raise GameError(
        f"no model {name!r}: neither shipped (there: {shipped}) nor a folder with {GAME}; "
        "fit one with `python -m shuttle_marl.dynamics fit`"
    )


@functools.cache
def load_game(name: str = "default") -> Game:
    """The game of a shipped model, or of the model in the folder ``name``.

    Raises:
        GameError: there is no such model, or its file is damaged.
    """
    folder = model_folder(name)
    game = Game.load(folder / GAME)
    _FOLDERS[game.hash] = folder
    return game


def read_model_card(folder: Path) -> dict[str, Any]:
    """The model card in a model folder.

    Raises:
        GameError: there is none, or it was changed after it was written.
    """
    try:
        return read_sealed(folder / CARD)
    except FileReadError as error:
        raise GameError(f"{folder / CARD}: no readable model card ({error}); fit or install the model again") from error


def read_model(folder: Path, name: str) -> Tensors:
    """The arrays of a file of a model folder, whose hash is the one in the model card.

    Args:
        folder: of the model.
        name: of the file, such as :data:`BC`.

    Raises:
        GameError: the model card cannot be read.
        OSError, ValueError: the file cannot be read, or is not the one of the model card.
    """
    hashes = read_model_card(folder).get("sha256")
    known = hashes.get(name) if isinstance(hashes, dict) else None
    if not isinstance(known, str):
        raise ValueError(f"{CARD} does not hold its hash")
    return read_tensors(folder / name, known)


def default_game() -> Game:
    """The benchmark's game: the symmetric average profile, as shipped."""
    return load_game()


def folder_of(game: Game) -> Path | None:
    """Folder of the model that a game was loaded from by :func:`load_game`; None for any other game."""
    if game.hash not in _FOLDERS and (_MODELS / "default" / GAME).is_file():
        load_game()
    return _FOLDERS.get(game.hash)


def refits_of(game: Game) -> tuple[Game, ...]:
    """The same game refitted on resampled matches; none for a variant, and for a game of a model without refits.

    Raises:
        GameError: the file of the variants is damaged.
    """
    folder = folder_of(game)
    if folder is None or not (folder / VARIANTS).is_file() or load_game(str(folder)).hash != game.hash:
        return ()
    return tuple(load_game(f"{folder}:{number}") for number in range(1, REFITS + 1))


def real_strokes(game: Game) -> npt.NDArray[np.float64] | None:
    """``[E]`` real strokes behind each edge: those in the innermost cell of the data that its stroke belongs to.

    None where that is not known: for games that belong to no model.

    Raises:
        GameError: the file of a model folder cannot be read.
    """
    folder = folder_of(game)
    if folder is None or not (folder / SUPPORT).is_file():
        return None
    try:
        return checked(read_model(folder, SUPPORT).arrays["strokes"], np.float64, (len(game.edge_own),))
    except (OSError, KeyError, ValueError) as error:
        raise GameError(f"{folder / SUPPORT}: no readable support ({error}); fit or install the model again") from error


def resolve_game(game: Game | str | None) -> Game:
    """A game, or that of a model by name or folder; None: the benchmark's.

    Raises:
        GameError: there is no such model, or its tables are damaged.
    """
    if game is None:
        return default_game()
    return game if isinstance(game, Game) else load_game(game)
