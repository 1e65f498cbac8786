"""Variants of a game: steps of log-odds, packed and unpacked, found by name, damaged."""

import json
import lzma
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from safetensors.numpy import save_file

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.tensor_files import Tensors, read_tensors
from shuttle_marl.dynamics.evaluate import write_card
from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game import shipped
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.shipped import (
    BC,
    OPPOSITE,
    STEP,
    VARIANTS,
    load_game,
    model_folder,
    moved,
    origin_of,
    packed,
    read_model_card,
    refits_of,
    resolve_game,
    steps_between,
    unpacked,
)
from shuttle_marl.game.tables import Game, thresholds
from shuttle_marl.policy import baselines
from tests.exact.exact_games import tiring_game
from tests.reduced import reduced_game, reduced_model


def shaken(game: Game, seed: int, spread: float = 0.4) -> Game:
    """The same layout with every probability's log-odds moved by a random amount."""
    rng = np.random.default_rng(seed)
    parts = [np.clip(part, 1e-4, 1 - 1e-4) for part in game.stroke_probabilities(game.block_pairs(0))]
    changed = [1 / (1 + np.exp(-(np.log(p / (1 - p)) + rng.normal(0, spread, p.shape)))) for p in parts]
    odds = np.rint(game.fault_odds * (1 + 0.1 * np.arange(game.levels))).astype(np.int32)
    hurry = rng.integers(0, 256, game.hurry.shape, dtype=np.uint8)
    return replace(game, threshold=thresholds(*changed), hurry=hurry, fault_odds=odds)


def parts_of(game: Game) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Part and rest of the three probabilities of each base pair."""
    fault, winner, below = game.threshold.T.astype(np.float64)
    return (fault, ONE - fault), (winner - fault, ONE - winner), (below - winner, ONE - below)


def test_probabilities_come_back_within_half_a_step() -> None:
    game = load_game()
    other = shaken(game, 1)
    found = moved(game, steps_between(game, other), other.fault_odds)
    assert found.fault_odds.tolist() == other.fault_odds.tolist()
    nearest = other.threshold[:, 1] >= 0.006 * ONE
    for before, stored, back in zip(*map(parts_of, (game, other, found)), strict=True):
        # Where a part is small, what is lost in rounding to 1/65536 shows.
        large = nearest & (np.minimum.reduce([*before, *stored, *back]) > 300)
        assert large.sum() > 0.2 * game.n_base_pairs
        log_odds = [np.log(part[large] / rest[large]) for part, rest in (before, stored, back)]
        assert np.abs(log_odds[2] - log_odds[1]).max() < STEP / 2 + 0.01
        assert np.abs(log_odds[0] - log_odds[1]).mean() > 5 * np.abs(log_odds[2] - log_odds[1]).mean()


def test_strokes_that_end_few_rallies_end_no_fewer() -> None:
    """A rally must end: rounding down would let it last longer than in the game that is stored."""
    game = load_game()
    other = shaken(game, 2, spread=0.1)
    found = moved(game, steps_between(game, other))
    rare = other.threshold[:, 1] < 0.006 * ONE
    assert rare.any()
    assert (found.threshold[rare, 1] >= other.threshold[rare, 1] - 2.0).all()


@pytest.mark.parametrize(("unit", "most"), [(1, 127), (4, 124)])
def test_steps_are_limited_to_a_byte(unit: int, most: int) -> None:
    """A step is a sixteenth of the log-odds: from a half to 1 in 65536 it would be 177 of them."""
    game = load_game()
    half, rare = (replace(game, threshold=np.tile(np.array(row, np.uint16), (game.n_base_pairs, 1))) for row in
                  ((ONE // 2, ONE // 2 + ONE // 4, ONE - ONE // 8), (1, 2, 3)))  # fmt: skip
    assert steps_between(half, rare, unit)[:3].max() == -most
    assert steps_between(rare, half, unit)[:3].min() == most


def even(*threshold: int, hurry: int = 64) -> Game:
    """A small game in which all strokes have the same probabilities."""
    game = tiring_game()
    table = np.tile(np.array(threshold, np.uint16), (game.n_base_pairs, 1))
    return replace(game, threshold=table, hurry=np.full_like(game.hurry, hurry))


def test_odds_are_multiplied_by_powers_of_e() -> None:
    game, size = even(1000, 3000, 30000), tiring_game().n_base_pairs

    def of(step: int) -> Game:
        return moved(game, np.full((5, size), step, np.int8))

    for step in (-16, -1, 1, 16):
        factor, found = np.exp(step / 16), of(step)
        shares = 1000 / ONE, 2000 / (ONE - 1000), 27000 / (ONE - 3000)
        fault, winner, below = (factor * share / (1 + (factor - 1) * share) for share in shares)
        expected = [fault, fault + (1 - fault) * winner]
        expected.append(expected[1] + (1 - expected[1]) * below)
        assert (found.threshold[0] / ONE).tolist() == pytest.approx(expected, abs=1.6 / ONE)
        late = factor * 0.25 / (1 + (factor - 1) * 0.25)
        assert (found.hurry[0] / 256).tolist() == pytest.approx([late, late], abs=0.51 / 256)
    assert of(-128).hash == of(-127).hash != of(-126).hash
    # No probability reaches 1.
    assert moved(even(65000, 65500, 65530, hurry=255), np.full((5, size), 127, np.int8)).threshold.max() == ONE - 1
    assert moved(even(65000, 65500, 65530, hurry=255), np.full((5, size), 127, np.int8)).hurry.max() == 255
    odds = np.array([ONE, ONE, 2 * ONE], np.int32)
    assert moved(game, np.zeros((5, size), np.int8), odds).fault_odds.tolist() == odds.tolist()


@pytest.fixture(autouse=True)
def the_same_origins_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    """A game is known to come from the folder where it was loaded last; here that is a copy."""
    monkeypatch.setattr(shipped, "_ORIGINS", dict(shipped._ORIGINS))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the small model with a profile and two refits."""
    folder = tmp_path_factory.mktemp("made") / "model"
    shutil.copytree(reduced_model(), folder, ignore=shutil.ignore_patterns(VARIANTS))
    game = reduced_game()
    replace_file(folder / VARIANTS, packed(game, {name: shaken(game, i) for i, name in enumerate(["men", "1", "2"])}))
    header, arrays = read_tensors(folder / BC)
    tilted = arrays["choice"]
    arrays = {name: array for name, array in arrays.items() if "." not in name or name == f"choice.{OPPOSITE}"}
    save_file({**arrays, "choice.men": tilted}, folder / BC, metadata=header)
    write_card(folder, read_model_card(folder))
    return folder


@pytest.fixture
def model(made: Path, tmp_path: Path) -> Path:
    """A folder of the same model that a test may change."""
    return Path(shutil.copytree(made, tmp_path / "model"))


def test_variants_are_found_by_name(model: Path) -> None:
    game = load_game(str(model))
    assert shipped.variants(str(model)) == ["men", "1", "2"]
    assert [refit.hash for refit in refits_of(game)] == [load_game(f"{model}:{number}").hash for number in (1, 2)]
    assert refits_of(load_game(f"{model}:men")) == ()
    men = load_game(f"{model}:men")
    assert men.hash != game.hash
    assert men.catalogue.names == game.catalogue.names
    assert origin_of(men) == (model, "men", False)
    assert model_folder(f"{model}:men") == model
    assert resolve_game(str(model), "men").hash == men.hash
    assert resolve_game(men, "men") is men
    with pytest.raises(GameError, match=r"no variant 'women' of model .*; there are: men, 1, 2"):
        load_game(f"{model}:women")
    with pytest.raises(GameError, match=r"no model 'nothing:men'"):
        load_game("nothing:men")
    with pytest.raises(GameError, match="expected the game of a model"):
        resolve_game(shaken(game, 9), "men")
    with pytest.raises(GameError, match="another variant"):
        resolve_game(men, "1")


def test_environments_play_the_game_of_a_discipline(model: Path) -> None:
    men = load_game(f"{model}:men")
    options: dict[str, Any] = {"game": f"{model}:men"}
    environments: list[Any] = [
        rally_v0.env(**options).unwrapped,
        match_v0.env(**options).unwrapped,
        gymnasium.make("shuttle_marl/Rally-v0", opponent="random", **options).unwrapped,
        gymnasium.make("shuttle_marl/Match-v0", opponent="random", **options).unwrapped,
        gymnasium.make_vec("shuttle_marl/Rally-v0", num_envs=2, opponent="random", **options),
        RallyEnv(4, **options),
        VersusEnv(4, opponents="random", **options),
    ]
    assert {env.game.hash for env in environments} == {men.hash}
    with pytest.raises(GameError, match="no variant 'women'"):
        rally_v0.env(game=f"{model}:women")


def test_the_average_player_of_a_discipline_plays_in_its_game(model: Path) -> None:
    of_game, men, refit = (baselines.load(None, load_game(f"{model}{end}")) for end in ("", ":men", ":1"))
    assert men.hash != of_game.hash
    assert refit.hash == of_game.hash
    player = baselines.clones(model).players[0]
    assert len({baselines.load(player, table.game).hash for table in (of_game, men)} | {men.hash}) == 3


def altered(folder: Path, change: Any) -> None:
    header, arrays = read_tensors(folder / VARIANTS)
    content = json.loads(header["variants"])
    change(content, arrays)
    save_file(arrays, folder / VARIANTS, metadata={"variants": json.dumps(content)})
    write_card(folder, read_model_card(folder))


@pytest.mark.parametrize("change", [
    lambda content, arrays: arrays.pop("1.steps"),
    lambda content, arrays: arrays.update({"1.steps": arrays["1.steps"][:-9].copy()}),
    lambda content, arrays: arrays.update({"1.steps": arrays["1.steps"][::-1].copy()}),
    lambda content, arrays: arrays.update({"1.steps": arrays["2.steps"]}),
    lambda content, arrays: arrays.update({"1.fault_odds": arrays["1.fault_odds"].astype(np.float32)}),
    lambda content, arrays: arrays.update({"1.fault_odds": arrays["1.fault_odds"][:0].copy()}),
    lambda content, arrays: content["hashes"].update({"1": "0" * 64}),
    lambda content, arrays: content.update({"game": "0" * 64}),
    lambda content, arrays: content.pop("hashes"),
    lambda content, arrays: content.update({"hashes": [1]}),
])  # fmt: skip
def test_a_forged_file_of_variants_is_refused(model: Path, change: Any) -> None:
    altered(model, change)
    with pytest.raises(GameError, match=r"variants\.safetensors: no readable variants"):
        load_game(f"{model}:1")


def test_a_damaged_file_of_variants_is_refused(model: Path) -> None:
    content = bytearray((model / VARIANTS).read_bytes())
    content[len(content) // 2] ^= 1
    (model / VARIANTS).write_bytes(content)
    with pytest.raises(GameError, match=r"variants\.safetensors: no readable variants .*checksum"):
        load_game(f"{model}:men")


def test_what_unpacks_to_more_than_a_table_is_refused_before_it_does() -> None:
    game = load_game()
    header = {"variants": json.dumps({"game": game.hash, "hashes": {"1": ""}})}
    bomb = np.frombuffer(lzma.compress(bytes(10**8), preset=0), dtype=np.uint8)
    with pytest.raises(GameError, match=f"a packed array of {5 * game.n_base_pairs + 1} bytes, expected"):
        unpacked(Tensors(header, {"1.steps": bomb, "1.fault_odds": game.fault_odds}), game, "1", Path("model"))


def test_models_with_the_same_tables_have_their_own_refits() -> None:
    few, one = load_game(reduced_model()), load_game(reduced_model(("1",)))
    assert few.hash == one.hash
    assert [len(refits_of(game)) for game in (few, one, few)] == [2, 1, 2]


def test_counterparts_are_the_same_flight_with_own_strokes_on_the_other_side() -> None:
    opposite, model = load_game(f"default:{OPPOSITE}"), load_game("default")
    same = opposite.counterparts(model)
    here = np.flatnonzero(same >= 0)
    assert len(here) > 0.9 * len(same)
    state, other = opposite.base_pair_state[here], model.base_pair_state[same[here]]
    for name in ("incoming", "contact", "hurried"):
        assert (getattr(opposite, name)(state) == getattr(model, name)(other)).all()
    side = np.append(opposite.catalogue.other_side, opposite.n_strokes)
    assert (side[opposite.base_pair_stroke[here]] == model.base_pair_stroke[same[here]]).all()
    exact = side[opposite.own(state)] == model.own(other)
    assert exact.mean() > 0.5
    rest = state[~exact]
    seen = (side[opposite.own(rest)], opposite.incoming(rest), opposite.contact(rest), opposite.duel(rest))
    missing = model.state_of(*seen, 0, 0, opposite.hurried(rest))
    assert (missing < 0).all(), "another last stroke stands where the game has no such state"
