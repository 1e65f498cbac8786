"""The fixed splits against the shipped manifest, and the names of players."""

import json
from pathlib import Path

import pytest

from shuttle_marl.data import matches_of, upstream
from shuttle_marl.data.shuttleset import SHOT_NAMES
from shuttle_marl.data.upstream import SPLITS, discipline, player_id
from shuttle_marl.game.stroke import SHOTS


def test_every_published_match_is_in_exactly_one_split() -> None:
    published = {upstream.match_of(path) for path in upstream.manifest()} - {None}
    by_split = [set(matches_of(split)) for split in SPLITS]
    assert [len(names) for names in by_split] == [68, 14, 12]
    assert set.union(*by_split) == published
    assert sum(map(len, by_split)) == len(published) == 94


@pytest.mark.parametrize(("name", "identifier", "kind"), [
    ("CHEN Yufei", "chen-yufei", "WS"), ("Chen Yufei", "chen-yufei", "WS"), ("HE Bingjiao", "he-bingjiao", "WS"),
    ("PUSARLA V. Sindhu", "pusarla-v-sindhu", "WS"), ("PRANNOY H. S.", "prannoy-h-s", "MS"),
    ("Hans-Kristian Solberg VITTINGHUS", "hans-kristian-solberg-vittinghus", "MS"), ("Nobody", "nobody", None),
])  # fmt: skip
def test_players(name: str, identifier: str, kind: str | None) -> None:
    assert player_id(name) == identifier
    assert discipline(identifier) == kind


def test_no_player_has_two_disciplines() -> None:
    names = json.loads(Path(upstream.__file__).with_name("players.json").read_text(encoding="utf-8"))
    assert sorted(names) == ["MS", "WS"]
    assert not set(names["MS"]) & set(names["WS"])


def test_every_shot_type_has_a_name_in_the_files() -> None:
    assert set(SHOT_NAMES.values()) == set(SHOTS)
