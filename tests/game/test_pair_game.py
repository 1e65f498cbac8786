"""The game of a pair: skill of players, dates, and the tables of both seats."""

import datetime
import hashlib
import json
import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load as load_arrays

from shuttle_marl.base.files import seal
from shuttle_marl.base.tensor_files import tensor_bytes
from shuttle_marl.game import pairs
from shuttle_marl.game.pairs import game_of_people, pair_game, people_of, trained_game
from shuttle_marl.game.shipped import CARD, SKILL, load_game, model_folder, origin_of, read_model_card
from shuttle_marl.game.skill import Skill, load_skill
from shuttle_marl.game.stroke import SHOTS, Catalogue
from shuttle_marl.game.tables import Game, GameError
from shuttle_marl.game.tabulated import base_pairs, layout
from tests.reduced import reduced_game, reduced_model

A, B, WOMAN = "viktor-axelsen", "kento-momota", "an-se-young"
OTHER_WOMAN = "anders-antonsen"  # in the random skill of the small model


def skill() -> Skill:
    return load_skill(model_folder(reduced_model()))


def pair(a: str = A, b: str = B, **options: Any) -> Game:
    return pair_game(a, b, game=reduced_model(), **options)


def fixed_game() -> Game:
    """Six strokes with random thresholds of a fixed seed: the same on every machine and in every version of the models."""
    names = [
        "short-serve:front-left:below:backhand", "lift:back-left:below:forehand", "smash:middle-left:above:forehand",
        "block:front-right:below:backhand", "net-shot:front-left:below:forehand", "drop:front-right:above:forehand",
    ]  # fmt: skip
    catalogue = Catalogue.from_names(names)
    replies = np.ones((len(names) + 1, len(names)), dtype=np.bool_)
    replies[:-1, 0], replies[-1, 1:] = False, False
    tables = layout(catalogue, replies)
    draws = np.random.Generator(np.random.PCG64(5)).integers(500, 65000, (base_pairs(tables), 3), dtype=np.uint16)
    return Game(catalogue=catalogue, **tables, threshold=np.sort(draws, axis=1), hurry=np.zeros((len(draws), 2), np.uint8))


def test_two_average_players_play_the_average_game() -> None:
    game, both = reduced_game(), pair("average", "average")
    for table, tables in zip(both.threshold, both.seats, strict=True):
        assert table.tobytes() == game.threshold.tobytes()
        assert tables.hash == game.hash
    men = load_game(f"{reduced_model()}:men")
    assert pair("average", "average", discipline="men").seats[1].hash == men.hash


def test_tables_have_the_log_odds_of_both_players() -> None:
    """In numpy's floating point, for probabilities that rounding to 1/65536 hardly changes."""
    men, both, table = load_game(f"{reduced_model()}:men-opposite"), pair(), skill()
    shot = men.catalogue.shot[men.base_pair_stroke]
    for seat, (striker, receiver) in enumerate(((A, B), (B, A))):
        knots = table.knot(striker), table.knot(receiver)
        offset = np.zeros((3, len(SHOTS)))
        for k, group in enumerate(table.group):
            for role, knot in enumerate(knots):
                offset[:, k] += table.offset[knot, :, role, 0] + table.offset[knot, :, role, 1 + group]
        before, after = (_chances(game.threshold.astype(np.float64) / 65536) for game in (men, both.seats[seat]))
        for component, (old, new) in enumerate(zip(before, after, strict=True)):
            plain = (old > 0.02) & (old < 0.98) & (before[1] > 0.2) & (before[0] < 0.8)
            change = np.log(new / (1 - new)) - np.log(old / (1 - old))
            assert plain.sum() > 100
            assert np.abs(change - offset[component, shot])[plain].max() < 0.01


def _chances(threshold: Any) -> tuple[Any, Any, Any]:
    """Probability of a fault, of the return of a good stroke, of a contact above at a return."""
    fault, winner, below = threshold.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return fault, (1 - winner) / (1 - fault), (1 - below) / (1 - winner)


def test_the_tables_are_the_same_on_every_machine() -> None:
    rng = np.random.Generator(np.random.PCG64(6))
    offset = rng.integers(-1000, 1000, (3, len(SHOTS))) / 1024
    table = pairs._with_skill(fixed_game(), offset)
    assert hashlib.sha256(table.tobytes()).hexdigest()[:16] == "9f84ca9ec61e49be"
    assert (table[:, 1:] >= table[:, :-1]).all()


def test_exchanged_players_have_exchanged_tables() -> None:
    both, other = pair(), pair(B, A)
    assert both.seats[0].hash == other.seats[1].hash != both.seats[1].hash
    assert both.swapped.hash == other.hash != both.hash
    assert both.swapped.people.players == (B, A)
    assert both.seats[0].opposite is both.seats[1]


def test_a_pair_and_its_seats_are_pickled_by_name() -> None:
    both = pair(date="2020-06-01")
    content = pickle.dumps(both)
    assert len(content) < 1000
    copy = pickle.loads(content)
    assert (copy.hash, copy.people.players, copy.people.date) == (both.hash, both.people.players, datetime.date(2020, 6, 1))
    seat = pickle.loads(pickle.dumps(both.seats[1]))
    assert (seat.hash, seat.seat, origin_of(seat)) == (both.seats[1].hash, 1, both.people.origin)


def test_the_last_skill_on_or_before_the_day() -> None:
    table, first = skill(), datetime.date(2019, 1, 1)
    for day, expected in (
        (None, 2021), ("2018-05-05", 2019), ("2019-01-01", 2019), ("2020-12-31", 2019), ("2021-01-01", 2021), (first, 2019),
    ):  # fmt: skip
        assert table.since(A, day) == datetime.date(expected, 1, 1), day
    assert table.since("average") is None
    assert pair(date="2019-03-01").hash == pair(date=first).hash != pair().hash
    with pytest.raises(GameError, match=r"date '1\.1\.2020': expected year-month-day"):
        pair(date="1.1.2020")


def test_players_of_one_discipline() -> None:
    with pytest.raises(GameError, match=f"{WOMAN} plays women's singles"):
        pair(A, WOMAN)
    with pytest.raises(GameError, match="in women's singles: viktor-axelsen plays men's singles"):
        pair(A, B, discipline="women")
    assert pair(WOMAN, OTHER_WOMAN).people.discipline == pair("average", WOMAN).people.discipline == "women"
    with pytest.raises(GameError, match="no skill of the player 'nobody'; there are: average, viktor"):
        pair(A, "nobody")
    with pytest.raises(GameError, match="discipline 'mixed': expected one of men, women"):
        pair("average", "average", discipline="mixed")
    with pytest.raises(GameError, match="is the game of women's"):
        pair_game(A, B, game=f"{reduced_model()}:women")
    assert pair_game(A, B, game=f"{reduced_model()}:men").hash == pair().hash


def test_the_pair_in_refits() -> None:
    refits = pair().people.refits()
    assert [people_of(refit).model for refit in refits] == [f"{reduced_model()}:{name}" for name in "12"]
    assert len({pair().hash, *(refit.hash for refit in refits)}) == 3
    assert all(refit.people.players == (A, B) and refit.people.refits() == () for refit in refits)
    plain = pair_game("average", "average", game=f"{reduced_model()}:1")
    assert plain.seats[0].hash == load_game(f"{reduced_model()}:1").hash


def test_game_of_two_people() -> None:
    both = game_of_people(reduced_game(), (A, B))
    assert both.hash == pair().hash
    assert game_of_people(reduced_game(), (A, "nobody")) is None
    assert game_of_people(fixed_game(), (A, B)) is None
    assert game_of_people(pair(), (A, B)) is None


def test_a_pair_in_a_game_of_different_hands_has_its_own_hands() -> None:
    for name in ("opposite", "men-opposite"):
        assert pair_game(A, B, game=f"{reduced_model()}:{name}").hash == pair().hash
    assert pair_game(A, B, game=f"{reduced_model()}:1-opposite").hash == pair_game(A, B, game=f"{reduced_model()}:1").hash


def test_agents_of_a_game_play_in_that_of_different_hands() -> None:
    for name, trained in (("opposite", ""), ("men-opposite", ":men"), ("women", ":women"), ("1-opposite", ":1")):
        assert trained_game(load_game(f"{reduced_model()}:{name}")).hash == load_game(f"{reduced_model()}{trained}").hash
    assert trained_game(pair()).hash == reduced_game().hash
    assert trained_game(fixed_game()).hash == fixed_game().hash


def test_a_model_without_skill(tmp_path: Path) -> None:
    with pytest.raises(GameError, match="has no skill of players"):
        load_skill(tmp_path)


@pytest.mark.parametrize("name", ["unsorted days", "unsorted players", "group", "shape", "finite", "names", "hash"])
def test_damaged_skill(tmp_path: Path, name: str) -> None:
    folder = shutil.copytree(reduced_model(), tmp_path / "model")
    content = (folder / SKILL).read_bytes()
    arrays, names = dict(load_arrays(content)), list(skill().players)
    if name == "unsorted days":
        arrays["day"] = arrays["day"][::-1].copy()
    if name == "unsorted players":
        arrays["player"] = arrays["player"][::-1].copy()
    if name == "group":
        arrays["group"] = arrays["group"] + np.int8(1)
    if name == "shape":
        arrays["offset"] = arrays["offset"][:-1]
    if name == "finite":
        arrays["deviation"][3] = np.nan
    if name == "names":
        names[0] = "average"
    changed = tensor_bytes(arrays, {"skill": json.dumps({"players": names})})
    (folder / SKILL).write_bytes(changed if name != "hash" else content + b" ")
    if name != "hash":
        card = read_model_card(folder)
        card["sha256"][SKILL] = hashlib.sha256(changed).hexdigest()
        (folder / CARD).write_bytes(seal(card))
    with pytest.raises(GameError, match="no readable skill of players"):
        load_skill(folder)


def test_people_change_seats_with_their_hands() -> None:
    people = pairs.People(players=(A, B), date=datetime.date(2020, 5, 1), model=reduced_model(), hands=("right", "left"))
    assert (people.swapped.players, people.swapped.hands) == ((B, A), ("left", "right"))
    assert people.swapped.swapped == people
    assert people.opposite
    assert people.swapped.opposite
    assert people.title == f"{A} against {B} as of 2020-05-01"
