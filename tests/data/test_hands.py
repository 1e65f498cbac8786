"""Hands of players: inferred from strokes around the head, given in a column, told by ``--hand``; and what is said about them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.analysis import main as analysis
from shuttle_marl.commands.data import main
from shuttle_marl.commands.dynamics import main as dynamics
from shuttle_marl.commands.report import main as report
from shuttle_marl.commands.scout import main as scout
from shuttle_marl.data import Account, DataError, clean_matches, read_matches, write_parquet
from shuttle_marl.data.hands import hands_of, telling_hands, unknown_hands
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import STROKES, violations
from shuttle_marl.game.court import HANDS
from tests.data.upstream_layout import LIFT, SERVE, SMASH, Hit, Layout, game, rally
from tests.reduced import reduced_model

HEADER = "rally,player,shot,height,technique,area,ending"


def club(folder: Path, sides: Mapping[str, Sequence[str]], name: str = "own.csv") -> Path:
    """A CSV file of a match: in each rally a player strikes a lift to one of ``sides`` around the head, and out."""
    lines, number = [HEADER], 0
    for player, other in (tuple(sides), tuple(sides)[::-1]):
        for side in sides[player]:
            number += 1
            lines += [
                f"{number},{player},short serve,below,backhand,front-centre,",
                f"{number},{other},lift,below,forehand,back-{side},",
                f"{number},{player},clear,above,around the head,back-centre,out",
            ]
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def hand(strokes: pa.Table) -> dict[str, str]:
    """Hands of a table by player; every row of a player has the same."""
    assert list(violations(strokes)) == []
    players = zip(strokes["player"].to_pylist(), strokes["hand"].to_pylist(), strict=True)
    found = {player: "unknown" if number is None else HANDS[number] for player, number in set(players)}
    assert len(found) == len(set(strokes["player"].to_pylist()))
    return found


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """Ada's strokes around the head are on her right, Bea's tell nothing."""
    return club(tmp_path, {"Ada": ["right"] * 12, "Bea": ["right", "left"] * 6})


@pytest.mark.parametrize(("sides", "shown"), [
    (["right"] * 7 + ["left"] * 3, "left"),
    (["right"] * 6 + ["left"] * 4, "unknown"),
    (["right"] * 4 + ["left"] * 6, "unknown"),
    (["right"] * 3 + ["left"] * 7, "right"),
    (["right"] * 9 + ["centre"] * 9, "unknown"),
    (["left"] * 9, "unknown"),
    (["left"] * 10 + ["centre"] * 9, "right"),
])  # fmt: skip
def test_the_side_of_ten_strokes_around_the_head_tells_the_hand(tmp_path: Path, sides: list[str], shown: str) -> None:
    strokes = read_matches(club(tmp_path, {"Ada": sides, "Bea": []}))
    assert hand(strokes)["ada"] == shown
    known = [side for side in sides if side != "centre"]
    ada = hands_of(strokes)["ada"]
    assert (ada.n, ada.share) == (len(known), known.count("right") / len(known))
    assert (hands_of(strokes)["bea"].n, hands_of(strokes)["bea"].share) == (0, None)


def test_only_overhead_strokes_around_the_head_count(tmp_path: Path) -> None:
    path = club(tmp_path, {"Ada": ["right"] * 20, "Bea": []})
    text = path.read_text(encoding="utf-8")
    for change in (("above,around the head", "above,forehand"), ("above,around the head", "below,around the head")):
        path.write_text(text.replace(*change), encoding="utf-8")
        assert hands_of(read_matches(path))["ada"].n == 0


def test_the_contact_point_counts_before_the_area(tmp_path: Path) -> None:
    layout = Layout(tmp_path / "raw")
    around = Hit("長球", 2.9, 6.0, height=1, around_head=True)  # the lift went to x = 1.9, which is the striker's -1.9
    layout.match("one", [game([rally(i, "A", [SERVE, LIFT, around], (0, i)) for i in range(1, 13)])])
    cleaned = clean_matches(tmp_path / "raw")
    player = next(name for name, found in hands_of(cleaned.strokes).items() if found.n)
    other = next(name for name in hands_of(cleaned.strokes) if name != player)
    assert hand(cleaned.strokes) == {player: "right", other: "unknown"}
    told = "hands of players, from the side of strokes around the head: 1 right-handed, 0 left-handed"
    assert cleaned.provenance["inferred"] == [told]
    assert cleaned.provenance["lost"] == [f"hand unknown, played as right-handed: {other} (1 of 2 players)"]
    rows = [row | {"contact_x": row["contact_x"] and -row["contact_x"], "hand": None} for row in cleaned.strokes.to_pylist()]
    assert hands_of(pa.Table.from_pylist(rows, schema=STROKES))[player].share == 1


def test_a_dropped_stroke_or_another_rally_tells_nothing(both: Path) -> None:
    strokes = read_matches(both)
    rows = strokes.to_pylist()
    gaps = pa.Table.from_pylist([row for row in rows if row["stroke"] != 2], schema=STROKES)
    assert {name: found.n for name, found in hands_of(gaps).items()} == {"ada": 0, "bea": 0}
    assert hands_of(strokes.slice(0, 0)) == {}


def test_inferred_areas_tell_no_hand_and_are_where_the_receiver_meets_it(both: Path) -> None:
    lines = both.read_text(encoding="utf-8").splitlines()
    cut = [",".join((line.split(",")[:5]) + line.split(",")[6:]) for line in lines]
    both.write_text("\n".join(cut), encoding="utf-8")
    areas = {}
    for told in ((), ("Ada=left",)):
        with telling_hands(told):
            strokes = read_matches(both)
        assert hands_of(strokes)["ada"].n == 0
        areas[told] = strokes["area"].to_pylist()
    lifts_to_ada, lifts_to_bea = range(1, 36, 3), range(37, 72, 3)
    assert {areas[()][i] for i in (*lifts_to_ada, *lifts_to_bea)} == {8}  # back left
    assert {areas["Ada=left",][i] for i in lifts_to_ada} == {6}
    assert {areas["Ada=left",][i] for i in lifts_to_bea} == {8}


def with_column(path: Path, words: Mapping[str, str], header: str = "hand") -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = [f"{line},{words.get(line.split(',')[1], '')}" for line in lines[1:]]
    path.write_text("\n".join([f"{lines[0]},{header}", *rows]) + "\n", encoding="utf-8")


@pytest.mark.parametrize(("header", "right", "left"), [
    ("hand", "R", "L"), ("Playing hand", "right-handed", "Left-hander"), ("持拍手", "右手", "左手"),
    ("利き手", "右利き", "左利き"), ("손", "오른손잡이", "왼손잡이"), ("Tangan", "kanan", "kidal"),
    ("hånd", "højre", "venstrehåndet"), ("हाथ", "दायां", "बायां"),
])  # fmt: skip
def test_a_column_gives_the_hand(both: Path, header: str, right: str, left: str) -> None:
    with_column(both, {"Ada": right, "Bea": left}, header)
    cleaned = import_matches(both)
    assert hand(cleaned.strokes) == {"ada": "right", "bea": "left"}
    assert not any("hand" in sentence for sentence in (*cleaned.provenance["inferred"], *cleaned.provenance["lost"]))


def test_an_option_tells_the_hand_before_all_else(both: Path) -> None:
    with_column(both, {"Bea": "right"})
    with telling_hands(["Bea=L", "bea=left", "ADA=Right-handed"]) as unknown:
        cleaned = import_matches(both)
    assert hand(cleaned.strokes) == {"ada": "right", "bea": "left"}
    assert cleaned.provenance["inferred"][-1] == "hands of players, told by --hand: 1 right-handed, 1 left-handed"
    assert unknown == [[]]
    assert hand(import_matches(both).strokes) == {"ada": "left", "bea": "right"}


@pytest.mark.parametrize(("words", "wrong"), [
    (["nobody=left"], "--hand 'nobody=left': no player 'nobody'"),
    (["left"], "--hand 'left': no player ''"),
    (["ada=both"], "--hand 'ada=both': 'both' is no hand"),
    (["ada=left", "Ada=right"], "--hand 'Ada=right': ada has two hands"),
])  # fmt: skip
def test_an_option_that_is_wrong_lists_the_players(both: Path, words: list[str], wrong: str) -> None:
    with pytest.raises(DataError) as caught, telling_hands(words):
        read_matches(both)
    assert f"{wrong}; expected NAME=right or NAME=left, players: ada, bea" in str(caught.value)


def test_hands_told_of_no_strokes() -> None:
    with pytest.raises(ShuttleError, match="--hand ada=left: no annotated strokes were read"), telling_hands(["ada=left"]):
        pass


def test_a_table_without_the_column_is_filled_when_it_is_loaded(both: Path, tmp_path: Path) -> None:
    strokes = read_matches(both)
    pq.write_table(strokes.drop_columns("hand"), tmp_path / "old.parquet")
    assert read_matches(tmp_path / "old.parquet").equals(strokes)
    with telling_hands(["bea=right"]):
        assert hand(read_matches(tmp_path / "old.parquet")) == {"ada": "left", "bea": "right"}
    given = pa.array([HANDS.index("right") if name == "ada" else None for name in strokes["player"].to_pylist()], pa.int8())
    pq.write_table(strokes.set_column(STROKES.get_field_index("hand"), STROKES.field("hand"), given), tmp_path / "given.parquet")
    assert hand(read_matches(tmp_path / "given.parquet")) == {"ada": "right", "bea": "unknown"}


def test_a_player_has_one_hand(both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strokes = read_matches(both)
    rows = strokes.to_pylist()
    rows[4] |= {"hand": 1}
    rows[6] |= {"hand": 0}
    broken = pa.Table.from_pylist(rows, schema=STROKES)
    assert [(v.rule, v.rows.tolist()) for v in violations(broken)] == [("all known hands of a player are the same", [6])]
    write_parquet(broken, tmp_path / "x.parquet", account=Account.of(broken), provenance={})
    assert main(["validate", str(tmp_path / "x.parquet")]) == 1
    assert "player 'ada', hand 0" in capsys.readouterr().out


def test_summary_lists_hands(both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "own.parquet"
    assert main(["import", str(both), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "inferred: hands of players, from the side of strokes around the head: 0 right-handed, 1 left-handed\n" in printed
    assert "not in the file: hand unknown, played as right-handed: bea (1 of 2 players)\n" in printed
    for path in (both, out):
        assert main(["summary", str(path), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["hands"] == {
            "ada": {"hand": "left", "n": 12, "share": 1.0},
            "bea": {"hand": "unknown", "n": 12, "share": 0.5},
        }
    assert main(["import", str(both), "--out", str(out), "--overwrite", "--hand", "ada=right", "--hand", "bea=left"]) == 0
    capsys.readouterr()
    assert main(["summary", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "bea" in printed
    assert "ada" not in printed


def test_pseudonyms_hide_the_names_in_the_provenance(both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "own.parquet"
    assert main(["import", str(both), "--out", str(out), "--anonymous", "--json"]) == 0
    (sentence,) = json.loads(capsys.readouterr().out)["lost"]
    assert sentence in unknown_hands(read_matches(out))
    provenance = pq.read_schema(out).metadata[b"shuttle_marl.provenance"].decode()
    assert json.loads(provenance)["lost"] == [sentence]
    assert "bea (" not in provenance


def test_convert_takes_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = Layout(tmp_path / "raw")
    layout.match("one", [game([rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="對手落地致勝")])])
    out = tmp_path / "strokes.parquet"
    assert main(["convert", str(tmp_path / "raw"), "--out", str(out), "--hand", "viktor-axelsen=left"]) == 0
    assert hand(read_matches(out))["viktor-axelsen"] == "left"
    assert "inferred: hands of players, told by --hand: 0 right-handed, 1 left-handed\n" in capsys.readouterr().out


def test_commands_that_read_strokes_take_the_option(both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out.html")
    for command, arguments in (
        (analysis, [str(both)]),
        (report, [str(both), "--out", out]),
        (scout, ["viktor-axelsen", "--data", str(both), "--out", out]),
        (dynamics, ["fit", "--data", str(both), "--out", str(tmp_path / "model")]),
    ):
        assert command([*arguments, "--hand", "ada=left", "--hand", "nobody=left"]) == 1
        assert "no player 'nobody'; expected NAME=right or NAME=left, players: ada, bea" in capsys.readouterr().err
    told = [str(both), "--json", "--game", reduced_model()]
    assert analysis(told) == 0
    assert "hand unknown, played as right-handed: bea (1 of 2 players)" in capsys.readouterr().err
    assert analysis([*told, "--hand", "bea=right"]) == 0
    assert "hand unknown" not in capsys.readouterr().err
