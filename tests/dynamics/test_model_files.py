"""Files of a model, forged and of others; and its trees: the arrays say what LightGBM says."""

import contextlib
import hashlib
import itertools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file
from scipy.special import expit

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import seal
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.data import read_matches
from shuttle_marl.dynamics.boosting import PARAMETERS
from shuttle_marl.dynamics.compiled import load_support
from shuttle_marl.dynamics.evaluate import write_card
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.fitted import FittedModels, ModelError
from shuttle_marl.dynamics.models import fit_trees
from shuttle_marl.dynamics.modules import INPUTS, attributes
from shuttle_marl.game.layout import GameError, base_pairs
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.shipped import BC, CARD, GAME, NETWORKS, SUPPORT, model_folder, read_model_card
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.baselines import clones

NESTED = "[" * 100_000
SERVE, LIFT = "short-serve:front-centre:below:backhand", "lift:back-centre:below:forehand"
SMASH = "smash:middle-left:above:forehand"


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A copy of the shipped model."""
    return Path(shutil.copytree(model_folder(), tmp_path / "model", ignore=shutil.ignore_patterns("agents")))


READERS: dict[str, Callable[[Path], Any]] = {
    GAME: lambda folder: Game.load(folder / GAME).hash,
    BC: lambda folder: clones.__wrapped__(folder).style.tobytes(),
    CARD: lambda folder: json.dumps(read_model_card(folder)),
    NETWORKS: lambda folder: FittedModels.load(folder).m_ret.ridge.weight.numpy().tobytes(),
    SUPPORT: lambda folder: load_support(folder).fault_range.tobytes(),
}


@pytest.mark.parametrize("name", [BC, NETWORKS, SUPPORT])
def test_files_of_another_model_are_refused(model: Path, name: str) -> None:
    header, arrays = read_tensors(model / name)
    save_file({key: array.copy() for key, array in arrays.items()}, model / name, metadata={**header, "note": "another"})
    with pytest.raises(ShuttleError, match="its checksum does not match"):
        READERS[name](model)
    write_card(model, read_model_card(model))
    READERS[name](model)


def forged(model: Path, name: str, key: str, change: Callable[[Any], Any]) -> None:
    """Replace an array or a text of a file, and its hash in the model card."""
    header, arrays = read_tensors(model / name)
    arrays = {k: array.copy() for k, array in arrays.items()}
    target: dict[str, Any] = arrays if key in arrays else header
    target[key] = change(target[key])
    save_file(arrays, model / name, metadata=header)
    write_card(model, read_model_card(model))


@pytest.mark.parametrize(("name", "key", "change", "error"), [
    (BC, "players", lambda _: NESTED, PolicyError),
    (BC, "players", lambda _: "[1]", PolicyError),
    (BC, "choice", lambda a: a * np.nan, PolicyError),
    (BC, "choice", lambda a: a.astype(np.complex64), PolicyError),
    (BC, "style", lambda a: a[:, :3], PolicyError),
    (NETWORKS, "model", lambda _: "[]", ModelError),
    (NETWORKS, "ridge", lambda a: a.astype(np.complex64), ModelError),
    (NETWORKS, "calibration", lambda a: a + np.inf, ModelError),
    (NETWORKS, "success.linear", lambda a: a.astype(np.float32), ModelError),
    (SUPPORT, "strokes", lambda a: a * np.nan, ModelError),
    (SUPPORT, "fault_range", lambda a: a[:5], ModelError),
])  # fmt: skip
def test_forged_files_with_fitting_hashes_are_refused(
    model: Path, name: str, key: str, change: Callable[[Any], Any], error: type[ShuttleError]
) -> None:
    forged(model, name, key, change)
    with pytest.raises(error, match=name):
        READERS[name](model)


@pytest.mark.parametrize("text", [NESTED, "[]", "{}", '{"sha256": 5}', "", "\0", seal({"sha256": 5}).decode(), seal({}).decode()])
def test_a_model_card_that_is_none(model: Path, text: str) -> None:
    (model / CARD).write_text(text)
    for name in (BC, NETWORKS, SUPPORT):
        with pytest.raises(ShuttleError, match=r"card\.json|the card does not hold"):
            READERS[name](model)


def hand_made() -> dict[str, Any]:
    """Tables of a serve, a lift and a smash."""
    arrays = {
        "edge_own": [3, 3, 0, 0, 1, 1, 2, 2],
        "edge_incoming": [3, 0, 1, 2, 1, 2, 1, 2],
        "edge_duel": [0] * 8,
        "reply_start": [[[1, 2]] * 2, [[3, 4]] * 2, [[5, 6]] * 2, [[0, 1]] * 2],
        "reply_count": [[1, 1], [1, 1], [1, 1], [1, 0]],
        "reply_edge": [1, 2, 3, 4, 5, 6, 7],
    }
    tables: dict[str, Any] = {name: np.array(values, np.int32) for name, values in arrays.items()}
    probabilities = {"threshold": np.full((30, 3), 9, np.uint16), "hurry": np.full((30, 2), 7, np.uint8)}
    return {**tables, **probabilities, "fault_odds": np.array([1 << 16], np.int32)}


def saved(path: Path, arrays: dict[str, Any], names: str = json.dumps([SERVE, LIFT, SMASH])) -> Path:
    """A file whose hash fits whatever it holds.

    It holds differences of probabilities in the order of the edges that follow; here all pairs have the same ones, so order is no
    matter.
    """
    digest = hashlib.sha256()
    with contextlib.suppress(RecursionError, ValueError, TypeError, AttributeError, ShuttleError):
        digest = hashlib.sha256(Catalogue.from_names(json.loads(names)).version.encode())
    for name, array in arrays.items():
        digest.update(f"{name}{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    differences = {name: np.diff(arrays[name].T, axis=1, prepend=0 * arrays[name].T[:, :1]) for name in ("threshold", "hurry")}
    stored = {name: np.ascontiguousarray(array) for name, array in {**arrays, **differences}.items()}
    save_file(stored, path, metadata={"strokes": names, "hash": digest.hexdigest()})
    return path


def test_a_game_written_down_by_hand_is_read(tmp_path: Path) -> None:
    game = Game.load(saved(tmp_path / GAME, hand_made()))
    assert game.legal_count(np.arange(game.n_states)).tolist() == [1, 0, 1, 0, *[1] * 28]
    assert game.threshold.tolist() == [[9, 9, 9]] * 30
    assert game.hurry.tolist() == [[7, 7]] * 30


@pytest.mark.parametrize("name", ["edge_own", "edge_incoming", "reply_start", "reply_count", "reply_edge"])
def test_no_forged_index_reaches_compiled_code(tmp_path: Path, name: str) -> None:
    for at, value in itertools.product(range(hand_made()[name].size), (-1, 2, 4, -(2**31), 2**31 - 1)):
        arrays = hand_made()
        unused = name == "reply_start" and arrays["reply_count"][at // 4, at % 2] == 0
        if arrays[name].flat[at] != value and not unused:
            arrays[name].flat[at] = value
            with pytest.raises(GameError, match=r"game\.safetensors"):
                Game.load(saved(tmp_path / GAME, arrays))


def test_a_state_without_legal_strokes_is_refused(tmp_path: Path) -> None:
    """The smash has no reply from above, and the last state would read behind the tables."""
    arrays = hand_made()
    arrays["edge_own"], arrays["edge_incoming"] = arrays["edge_own"][:-1], arrays["edge_incoming"][:-1]
    arrays["reply_count"][2, 1] = 0
    arrays["reply_start"][2, :, 1] = 0
    arrays["reply_edge"], arrays["edge_duel"] = arrays["reply_edge"][:-1], arrays["edge_duel"][:-1]
    pairs = base_pairs(arrays)
    arrays["threshold"], arrays["hurry"] = np.full((pairs, 3), 9, np.uint16), np.full((pairs, 2), 7, np.uint8)
    with pytest.raises(GameError, match="has no legal stroke"):
        Game.load(saved(tmp_path / GAME, arrays))


@pytest.mark.parametrize("names", [NESTED, "[1, 2, 3]", "{}", json.dumps([LIFT, SMASH, SERVE])])
def test_other_names_are_refused(tmp_path: Path, names: str) -> None:
    with pytest.raises(GameError, match=r"game\.safetensors"):
        Game.load(saved(tmp_path / GAME, hand_made(), names))


SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


def sample() -> tuple[Rows, np.ndarray, np.ndarray]:
    """Strokes, and labels that depend on two attributes together."""
    rows = rows_from_strokes(read_matches(SAMPLE))
    truth = expit(np.where((rows.codes["shot"] % 3 == 0) ^ (rows.codes["contact"] == 1), 1.5, -1.5))
    return rows, np.random.default_rng(2).random(len(rows)) < truth, truth


def test_arrays_say_what_the_library_says() -> None:
    lightgbm = pytest.importorskip("lightgbm")
    rows, label, truth = sample()
    trees = fit_trees(rows.codes, label, leaves=6, rounds=40)
    x = attributes(rows.codes).numpy()
    data = lightgbm.Dataset(x, label.astype(int), categorical_feature=list(range(len(INPUTS))))
    booster = lightgbm.train({**PARAMETERS, "num_leaves": 6}, data, num_boost_round=40)
    assert np.abs(booster.predict(x, raw_score=True) - trees.logits(rows.codes)).max() < 1e-12
    assert np.abs(expit(trees.logits(rows.codes)) - truth).mean() < 0.1
    again = fit_trees(rows.codes, label, leaves=6, rounds=40)
    assert all(np.array_equal(value, again.arrays[name]) for name, value in trees.arrays.items())
