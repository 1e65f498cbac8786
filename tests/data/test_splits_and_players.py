"""The fixed splits against the shipped manifest, and the names of players."""

import pytest

from shuttle_marl.data import matches_of, upstream
from shuttle_marl.data.upstream import SPLITS, discipline, player_id


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
