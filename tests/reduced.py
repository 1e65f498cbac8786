"""A small sister of the shipped model: a third of its strokes, of all shots, and what goes with them; it is solved at once.

Efforts, duels, players, disciplines and refits are all there, and every probability is that of the shipped game. Tests of
what is computed, and of commands, need no more; tests of what is shipped take the shipped game.
"""

import functools
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from filelock import FileLock
from safetensors.numpy import save

from shuttle_marl.base.files import seal
from shuttle_marl.base.tensor_files import tensor_bytes
from shuttle_marl.game.layout import base_pairs, layout
from shuttle_marl.game.pairs import COMPONENTS, GROUPS, ROLES
from shuttle_marl.game.shipped import (
    BC,
    CARD,
    GAME,
    HABITS,
    HISTORY,
    HURRY,
    NETWORKS,
    OPPOSITE,
    OPPOSITE_GAME,
    POSITIONS,
    PROFILES,
    SKILL,
    SUPPORT,
    VARIANTS,
    default_game,
    load_game,
    model_folder,
    packed,
    read_model,
    read_model_card,
)
from shuttle_marl.game.stroke import SHOTS, Catalogue
from shuttle_marl.game.tables import Game

Ints = npt.NDArray[np.integer[Any]]

EVERY = 3
"""One stroke in so many of the shipped game stays, and fewer where what is played could not be answered."""
REFITS = ("1", "2")
"""Refits of the shipped model that the small one has too."""


@functools.cache
def reduced_model(refits: tuple[str, ...] = REFITS) -> str:
    """Folder of the model, made once in the folder of the test session; look, do not touch.

    Args:
        refits: of the shipped model that the small one has too.
    """
    session = Path(os.environ.get("SESSION_FOLDER") or tempfile.mkdtemp(prefix="session-"))
    folder = session / "-".join(("reduced-model", *refits))
    with FileLock(session / f"{folder.name}.lock"):
        if not (folder / CARD).exists():  # written last
            folder.mkdir(exist_ok=True)
            _write_model(folder, refits)
    return str(folder)


def _write_model(folder: Path, refits: Sequence[str]) -> None:
    shipped, source = default_game(), model_folder()
    games = {"": shipped, OPPOSITE: load_game(f"default:{OPPOSITE}")}
    smaller = {name: _smaller(game, _kept(list(games.values()))) for name, game in games.items()}

    def reduced(game: Game, name: str = "") -> Game:
        tables, _, pairs = smaller[name]
        return Game(**tables, threshold=game.threshold[pairs], hurry=game.hurry[pairs], fault_odds=game.fault_odds)

    game = reduced(shipped)
    game.save(folder / GAME)
    reduced(games[OPPOSITE], OPPOSITE).save(folder / OPPOSITE_GAME)
    players = read_model(source, BC)
    arrays = {
        name: array[smaller[OPPOSITE if OPPOSITE in name else ""][2]] if name.startswith("choice") else array
        for name, array in players.arrays.items()
    }
    (folder / BC).write_bytes(save(arrays, metadata=dict(players.metadata)))
    support = {
        name: np.ascontiguousarray(array[smaller[OPPOSITE if OPPOSITE in name else ""][1]])
        for name, array in read_model(source, SUPPORT).arrays.items()
    }
    (folder / SUPPORT).write_bytes(save(support))
    others = {name: reduced(load_game(f"default:{name}")) for name in (*PROFILES, *refits)}
    (folder / VARIANTS).write_bytes(packed(game, others))
    for name in (NETWORKS, HABITS, HISTORY, HURRY, POSITIONS):
        shutil.copy(source / name, folder)
    (folder / SKILL).write_bytes(random_skill(json.loads(players.metadata["players"])))
    hashes = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in folder.iterdir()}
    card = {**read_model_card(source), "game_hash": game.hash, "variants": list(others), "sha256": hashes}
    (folder / CARD).write_bytes(seal(card))


def random_skill(players: Sequence[str], seed: int = 27) -> bytes:
    """Content of a file of skill: random offsets at two days each; every third player is a woman, every fourth left-handed."""
    rng, m = np.random.default_rng(seed), len(players)
    shape = (2 * m, len(COMPONENTS), len(ROLES), 1 + len(GROUPS))
    of_shot = {"serve": "serve", "clear": "rear", "drop": "rear", "smash": "attack", "kill": "attack", "lift": "lift"}
    groups = [
        next((name for part, name in of_shot.items() if part in shot), "net" if "net" in shot else "block") for shot in SHOTS
    ]
    arrays = {
        "offset": rng.normal(0, 0.2, shape).astype(np.float32),
        "deviation": rng.uniform(0.05, 0.1, shape).astype(np.float32),
        "player": np.repeat(np.arange(m, dtype=np.int32), 2),
        "day": np.tile(np.array([17897, 18628], np.int32), m),  # the first days of 2019 and 2021
        "group": np.array([GROUPS.index(name) for name in groups], np.int8),
        "discipline": (np.arange(m) % 3 == 2).astype(np.int8),
        "hand": (np.arange(m) % 4 == 3).astype(np.int8),
        "strokes": rng.integers(500, 5000, m).astype(np.int32),
        "matches": rng.integers(1, 20, m).astype(np.int32),
    }
    return tensor_bytes(arrays, {"skill": json.dumps({"players": list(players)}, sort_keys=True)})


def reduced_game() -> Game:
    """The game of the model."""
    return load_game(reduced_model())


def _kept(games: Sequence[Game]) -> npt.NDArray[np.bool_]:
    """Which strokes of the catalogue stay: in each game what is played can be answered from both contacts."""
    kept = np.arange(games[0].n_strokes) % EVERY == EVERY - 1
    while True:
        open_ones = [
            kept & ~(game.reply_mask[:-1] & kept).any(axis=2).all(axis=1) & game.reply_mask[:-1].any(axis=(1, 2))
            for game in games
        ]
        if not np.any(open_ones):
            return kept
        kept &= ~np.any(open_ones, axis=0)


def _smaller(game: Game, kept: npt.NDArray[np.bool_]) -> tuple[dict[str, Any], Ints, Ints]:
    """Catalogue and layout of a game with fewer strokes, and which edges and base pairs of the larger one its own are."""
    old = np.append(np.flatnonzero(kept), game.n_strokes)
    catalogue = Catalogue.from_names([game.catalogue.names[k] for k in old[:-1]])
    replies = np.asarray(game.reply_mask.any(axis=1))[np.ix_(old, old[:-1])]
    tables = layout(catalogue, replies, duels=game.counts_duels)
    state = np.arange(4 * len(tables["edge_own"]))
    own, incoming, duel = (tables[name][state >> 2] for name in ("edge_own", "edge_incoming", "edge_duel"))
    of_state = game.state_of(old[own], old[incoming], state & 1, duel, hurried=state >> 1 & 1)
    size = base_pairs(tables)
    empty = Game(catalogue=catalogue, threshold=np.zeros((size, 3), np.uint16), hurry=np.zeros((size, 2), np.uint8), **tables)
    pairs = game.pair(of_state[empty.base_pair_state], old[empty.base_pair_stroke])
    assert of_state.min() >= 0
    assert pairs.min() >= 0
    return {"catalogue": catalogue, **tables}, of_state[::4] >> 2, pairs
