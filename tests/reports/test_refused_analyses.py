"""Questions that the strokes or the model cannot answer are refused with the reason."""

from pathlib import Path

import pyarrow as pa
import pytest

from shuttle_marl.data import Account, write_parquet
from shuttle_marl.data.schema import STROKES
from shuttle_marl.game.pairs import load_skill
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.league import pairs
from shuttle_marl.reports.match import match_report, matches_in
from shuttle_marl.reports.scouting import hand_of, with_hands_of_model
from shuttle_marl.reports.summary import AnalysisError, players_of, strokes_of
from tests.reports.played import strokes_of as rallies


def test_a_report_is_of_one_match_of_two() -> None:
    two = rallies("ABw", "ABw", match="xy")
    assert matches_in(two) == ["x", "y"]
    three = rallies("ABw", "Cw")
    for wrong, says in (
        (two, "2 matches of 2 players"),
        (three, "1 matches of 3 players"),
        (STROKES.empty_table(), "0 matches of 0"),
    ):
        with pytest.raises(AnalysisError, match=says):
            match_report(wrong)


MEN = ("viktor-axelsen", "kento-momota")


@pytest.mark.parametrize(
    ("some", "says"),
    [
        (MEN[:1], f"--players {MEN[0]}: expected two or more"),
        (MEN[:1] * 2, "each once"),
        ((MEN[0], "an-se-young"), "who play men's singles"),
    ],
)
def test_players_of_an_outlook_share_a_discipline(some: tuple[str, ...], says: str) -> None:
    assert pairs.players_of("men", "default", MEN[::-1]) == [*MEN[::-1]]
    with pytest.raises(AnalysisError, match=says):
        pairs.players_of("men", "default", some)


def test_hands_are_those_of_the_table_and_else_of_the_model() -> None:
    strokes = rallies("BCw", "BCw", hand=[None, 0, None, None])
    named = strokes.set_column(strokes.column_names.index("player"), STROKES.field("player"), pa.array(MEN * 2))
    assert [hand_of(named, name) for name in (*MEN, "x")] == [None, "right", None]
    told = with_hands_of_model(named, load_skill(model_folder()))
    assert told["hand"].to_pylist() == [0, 0, 0, 1], "the table comes first, row by row"


def test_files_without_strokes(tmp_path: Path) -> None:
    empty = STROKES.empty_table()
    write_parquet(empty, tmp_path / "e.parquet", account=Account.of(empty), provenance={})
    with pytest.raises(AnalysisError, match="no strokes; record or convert some first"):
        strokes_of(tmp_path / "e.parquet")
    assert players_of(rallies("ABAw", "Cw", "Dw")) == ["A", "B", "C", "D"], "most strokes first, then by name"
