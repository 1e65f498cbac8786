"""Questions that the strokes or the model cannot answer are refused with the reason."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from shuttle_marl.analysis import outlook
from shuttle_marl.analysis.match import match_report, matches_in
from shuttle_marl.analysis.scouting import _discipline, hand_of, with_hands_of_model
from shuttle_marl.analysis.summary import AnalysisError, players_of, strokes_of
from shuttle_marl.data import Account, write_parquet
from shuttle_marl.data.schema import STROKES
from tests.analysis.test_counted_figures import strokes_of as rallies


class People:
    """Skill of two men and a woman."""

    players = ("ada", "bob", "carl")

    def discipline_of(self, name: str) -> str | None:
        return {"ada": "women", "bob": "men", "carl": "men"}.get(name)

    def hand_of(self, name: str) -> str | None:
        return {"bob": "right", "carl": "left"}.get(name)


SKILL: Any = People()


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


@pytest.mark.parametrize(
    ("some", "says"),
    [((), ""), (("carl", "bob"), ""), (("bob",), "--players bob: expected two or more"), (("bob", "bob"), "each once"),
     (("bob", "ada"), "who play men's singles"), (("bob", "carl", "x"), "--players bob carl x: expected")],
)  # fmt: skip
def test_players_of_a_discipline(some: tuple[str, ...], says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlook, "load_skill", lambda _: SKILL)
    if says:
        with pytest.raises(AnalysisError, match=says):
            outlook.players_of("men", "default", some)
    else:
        assert outlook.players_of("men", "default", some) == list(some or ("bob", "carl"))
    with pytest.raises(AnalysisError, match="--pairs women: the model has 1 players of that discipline; a pair needs two"):
        outlook.players_of("women")


def test_players_share_a_discipline() -> None:
    data = rallies("DEw", "EDw").set_column(2, STROKES.field("discipline"), pa.array(["WS"] * 4))
    assert _discipline(SKILL, ["bob", "carl"], None) == "men"
    assert _discipline(SKILL, ["ada", "D"], data) == "women"
    with pytest.raises(AnalysisError, match="bob plays men and D plays women: expected one discipline"):
        _discipline(SKILL, ["bob", "D"], data)
    with pytest.raises(AnalysisError, match=r"no strokes of the player 'bobb' in the model or the data; did you mean bob\?"):
        _discipline(SKILL, ["bobb"], data)
    with pytest.raises(AnalysisError, match=r"no strokes of the player 'x' in the model or the data \("):
        _discipline(SKILL, ["x"], None)


def test_hands_are_those_of_the_table_and_else_of_the_model() -> None:
    strokes = rallies("BCw", "BCw", hand=[None, 0, None, None])
    names = pa.array(["bob", "carl"] * 2)
    named = strokes.set_column(strokes.column_names.index("player"), STROKES.field("player"), names)
    assert (hand_of(named, "bob"), hand_of(named, "carl"), hand_of(named, "x")) == (None, "right", None)
    told = with_hands_of_model(named, SKILL)
    assert told["hand"].to_pylist() == [0, 0, 0, 1], "the table comes first, row by row"


def test_files_without_strokes(tmp_path: Path) -> None:
    empty = STROKES.empty_table()
    write_parquet(empty, tmp_path / "e.parquet", account=Account.of(empty), provenance={})
    with pytest.raises(AnalysisError, match="no strokes; record or convert some first"):
        strokes_of(tmp_path / "e.parquet")
    assert players_of(rallies("ABAw", "Cw", "Dw")) == ["A", "B", "C", "D"], "most strokes first, then by name"
