"""The published data itself, where SHUTTLESET names a folder that holds it: the numbers of the datasheet."""

import os
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from shuttle_marl.data import clean_matches, matches_of, split_of, validate, write_parquet
from shuttle_marl.data.hands import hands_of
from shuttle_marl.data.inference import MET
from shuttle_marl.data.schema import DROP_REASONS, Cleaned
from shuttle_marl.game.court import AREAS, HANDS
from shuttle_marl.game.stroke import SHOTS

ROOT = os.environ.get("SHUTTLESET")
pytestmark = [pytest.mark.skipif(not ROOT, reason="SHUTTLESET names no folder"), pytest.mark.slow]


@pytest.fixture(scope="module")
def public(tmp_path_factory: pytest.TempPathFactory) -> Cleaned:
    """The matches of train and validation, whether the test matches are there or not."""
    folder = tmp_path_factory.mktemp("public")
    shutil.copytree(str(ROOT), folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*matches_of("test")))
    return clean_matches(folder)


def test_counts(public: Cleaned) -> None:
    account = public.account
    assert (account.matches, account.rallies, account.strokes) == (82, 6832, 70752)
    assert account.strokes_kept + sum(account.dropped.values()) == account.strokes
    assert account.strokes_kept >= 0.9 * account.strokes
    assert account.rallies_kept >= 0.8 * account.rallies
    assert account.area_agreement >= 0.985


def test_a_table_lacks_matches_of_which_every_stroke_was_dropped(public: Cleaned, tmp_path: Path) -> None:
    assert len(public.strokes["match"].unique()) == 80
    write_parquet(public.strokes, tmp_path / "s.parquet", account=public.account, provenance={})
    assert validate(tmp_path / "s.parquet").problems == ()


def test_the_datasheet_tells_these_numbers(public: Cleaned) -> None:
    path = Path(__file__).parents[2]
    lines = (path / "docs" / "datasheet.md").read_text(encoding="utf-8").splitlines()
    for reason, text in DROP_REASONS.items():
        assert f"| {reason} | {public.account.dropped.get(reason, 0):,} | {text} |" in lines
    text = " ".join(lines)
    account, matches = public.account, len(public.strokes["match"].unique())
    assert f"of which {account.strokes_kept:,} strokes of {account.rallies_kept:,} rallies in {matches} matches are kept" in text
    assert f"label inside the court {public.account.area_agreement:.1%} have" in text
    for split in ("train", "validation"):
        rows = public.strokes.filter(pa.array([split_of(name) == split for name in public.strokes["match"].to_pylist()]))
        rallies = rows.group_by(["match", "game", "rally"]).aggregate([]).num_rows
        kept = len(rows["match"].unique())
        assert f"| {split} | {len(matches_of(split))} | {kept} | {rallies:,} | {rows.num_rows:,} |" in lines


def test_the_datasheet_tells_the_hands(public: Cleaned) -> None:
    lines = (Path(__file__).parents[2] / "docs" / "datasheet.md").read_text(encoding="utf-8").splitlines()
    players = hands_of(public.strokes)
    names = {hand: [name for name, player in players.items() if player.name == hand] for hand in (*HANDS, "unknown")}
    shares = {hand: [players[name].share for name in found] for hand, found in names.items()}
    right, left = (
        f"{len(names[hand])} | {min(shares[hand]):.0%} to {max(shares[hand]):.0%} |".replace("%", " %") for hand in HANDS
    )
    (unknown,) = names["unknown"]
    assert f"| right | {right}" in lines
    assert f"| left: {', '.join(names['left'])} | {left}" in lines
    assert f"| unknown, played as right-handed: {unknown} | 1 | {players[unknown].n} strokes |" in lines
    rows = public.strokes.filter(pc.equal(public.strokes["hand"], HANDS.index("left")))
    share, matches = rows.num_rows / public.strokes.num_rows, len(rows["match"].unique())
    assert f"Left-handers play {rows.num_rows:,} strokes ({100 * share:.1f} %) in {matches} matches." in " ".join(lines)


def test_areas_of_replies_are_those_of_the_train_matches(public: Cleaned) -> None:
    names = [name for name in public.strokes["match"].unique().to_pylist() if split_of(name) == "train"]
    strokes = public.strokes.filter(pc.is_in(public.strokes["match"], pa.array(names)))
    rally = ("match", "game", "rally")
    column = {name: strokes[name].to_numpy(zero_copy_only=False) for name in (*rally, "stroke", "shot", "technique")}
    same = np.logical_and.reduce([column[name][1:] == column[name][:-1] for name in rally])
    rows = np.flatnonzero(same & (np.diff(column["stroke"]) == 1) & strokes["area"].is_valid().to_numpy()[:-1])
    area, reply, technique = strokes["area"].to_numpy()[rows].astype(int), column["shot"][rows + 1], column["technique"][rows + 1]
    for shot, entries in MET.items():
        for number, (name, share) in enumerate(entries, -1):
            chosen = (reply == SHOTS.index(shot)) & ((technique == number) | (number < 0))
            if chosen.sum() >= 30:
                assert np.bincount(area[chosen], minlength=9).argmax() == AREAS.index(name), (shot, number)
                assert (area[chosen] == AREAS.index(name)).mean() == pytest.approx(share, abs=0.0051), (shot, number)
