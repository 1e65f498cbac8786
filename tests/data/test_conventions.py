"""Labels of matches with a convention of their own, on simulated matches whose labels are known."""

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.data import matches_of
from shuttle_marl.data.cleaning import with_common_labels
from shuttle_marl.data.simulated import simulate
from shuttle_marl.game import default_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.policy import resolve

MATCH = "Viktor_Axelsen_Kunlavut_Vitidsarn_BWF_World_Championships_2022_Finals"


@pytest.fixture(scope="module")
def strokes() -> pa.Table:
    """Thirty matches of the average player, under the names of training matches."""
    player = resolve("bc", default_game())
    table = simulate(default_game(), {"one": player, "other": player}, matches=30, seed=5)
    names = [MATCH, *(name for name in sorted(matches_of("train")) if name != MATCH)]
    match = table["match"].combine_chunks().dictionary_encode().indices.to_numpy()
    return table.set_column(0, table.schema.field(0), pa.array(np.array(names)[match]))


def renamed(strokes: pa.Table, incoming: str, shot: str, name: str, share: float = 1.0) -> pa.Table:
    """The table with another name for some replies of the first match to a shot type."""
    match, codes, number = (strokes[column].to_numpy(zero_copy_only=False) for column in ("match", "shot", "stroke"))
    codes, before = codes.copy(), np.where(number > 1, np.roll(codes, 1), -1)
    those = (match == MATCH) & (before == SHOTS.index(incoming)) & (codes == SHOTS.index(shot))
    codes[those & (np.random.default_rng(0).random(len(codes)) < share)] = SHOTS.index(name)
    position = strokes.schema.get_field_index("shot")
    return strokes.set_column(position, strokes.schema.field(position), pa.array(codes))


def test_nothing_is_renamed_in_common_labels(strokes: pa.Table) -> None:
    table, found = with_common_labels(strokes)
    assert found == []
    assert table.equals(strokes)


@pytest.mark.parametrize(("incoming", "shot", "name"), [("drop", "net-shot", "block"), ("smash", "block", "net-shot")])
def test_a_convention_is_found_and_undone(strokes: pa.Table, incoming: str, shot: str, name: str) -> None:
    table, found = with_common_labels(renamed(strokes, incoming, shot, name))
    assert [(one.match, one.incoming, one.given, one.meant) for one in found] == [(MATCH, incoming, name, shot)]
    # Real strokes of that name in the match get the common one too.
    assert table.equals(renamed(strokes, incoming, name, shot))


def test_labels_that_all_use_are_not_renamed(strokes: pa.Table) -> None:
    assert with_common_labels(renamed(strokes, "lift", "smash", "half-smash"))[1] == []


def test_matches_without_others_keep_their_labels(strokes: pa.Table) -> None:
    alone = renamed(strokes, "drop", "net-shot", "block").filter(pa.compute.equal(strokes["match"], MATCH))
    assert with_common_labels(alone)[1] == []
