"""Single rows: cleaning of raw rallies, readers of other formats, and players, rallies and results of a table."""

import dataclasses
import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.base.files import content_hash
from shuttle_marl.data import DataError, clean_matches, cleaning, read_matches, readers, upstream
from shuttle_marl.data.column_map import ColumnMap, plain, whole
from shuttle_marl.data.columns import Columns
from shuttle_marl.data.hands import receiver_hands
from shuttle_marl.data.readers import badminton_db, elan, shuttleset_game, sportscode, tree
from shuttle_marl.data.readers.badminton_db import Point
from shuttle_marl.data.readers.reading import sheet_of
from shuttle_marl.data.schema import NAMES, REASONS, Cleaned, Outcome, named, outcome_of
from shuttle_marl.data.shuttleset import AREA_OF_LABEL
from shuttle_marl.data.strict_csv import StrictCsv
from shuttle_marl.data.table import anonymised, provenance_of, validate
from shuttle_marl.data.words import Words, bare
from shuttle_marl.game import court, rules
from shuttle_marl.game.stroke import SHOTS
from tests.data.test_written_matches import import_text
from tests.data.upstream_layout import CLEAR, LIFT, SERVE, SMASH, Hit, Layout, Row, game, pixel, plain_game, rally

HERE = Path("f")
SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


# Cleaning of raw rows.


def raw(rallies: str, strokes: str, letters: str, **columns: Any) -> Any:
    """Columns of a raw game, of numbers and letters of one character a row."""
    numbers = [np.array([int(c) for c in text]) for text in (rallies, strokes)]
    usual: dict[str, Any] = {"rally": numbers[0], "stroke": numbers[1], "by_a": np.array([c == "A" for c in letters])}
    return SimpleNamespace(**usual | {name: np.array(values) for name, values in columns.items()})


def test_rallies_begin_with_another_number_or_the_first_stroke() -> None:
    rows = raw("112222", "121211", "ABABAB")
    assert cleaning.rally_starts(rows).tolist() == [True, False, True, False, True, True]


@pytest.mark.parametrize(
    ("rallies", "strokes", "letters", "broken"),
    [("11122", "12312", "ABABA", "00000"), ("11122", "12412", "ABABA", "11100"), ("11122", "12312", "ABBBA", "11100"),
     ("11122", "23412", "ABABA", "11100"), ("00022", "12312", "ABABA", "11100"), ("11111", "12312", "ABABA", "00011"),
     ("11122", "12312", "ABAAA", "00011")],
)  # fmt: skip
def test_broken_rallies(rallies: str, strokes: str, letters: str, broken: str) -> None:
    rows = raw(rallies, strokes, letters)
    found = cleaning.broken_rallies(rows, cleaning.rally_starts(rows))
    assert "".join(str(int(each)) for each in found) == broken


def test_a_repeated_stroke_is_one_of_the_same_player_and_not_a_serve() -> None:
    class Rows(SimpleNamespace):
        def take(self, rows: Any) -> "Rows":
            return Rows(**{name: values[rows] for name, values in vars(self).items()})

    rows: Any = Rows(**vars(raw("2211111", "1211223", "ABAABAB")), line=np.arange(7))
    found, repeated = cleaning.arrange(rows)
    assert (found.line.tolist(), repeated) == ([2, 3, 4, 5, 6, 0, 1], 0), "by the number of the rally"
    rows.by_a[5] = rows.by_a[4]
    assert cleaning.arrange(rows)[0].line.tolist() == [2, 3, 4, 6, 0, 1]
    assert cleaning.arrange(rows)[1] == 1


def test_times_from_the_first_frame_are_times() -> None:
    rows: Any = SimpleNamespace(frame=np.array([0, 10, 20]), clock=np.array([0, 0, 1]), shot=np.array([0, 3, 4]))
    assert cleaning.timed(rows, np.array([True, False, False])).all()
    rows.frame, rows.clock = np.array([0, 10, 20, 5, 15, 30]), np.array([0, 0, 1, 3, 3, 4])
    rows.shot = np.array([0, 3, 4, 3, 4, 3])
    found = cleaning.timed(rows, np.arange(6) % 6 == 0)
    assert found.tolist() == [True, True, True, False, False, True], "the longest rising part"
    assert cleaning.timed(rows, np.arange(6) % 3 == 0).all(), "in each rally"


def test_outcomes_by_score_winner_and_reason() -> None:
    out, net, landed, misjudged = (REASONS.index(name) for name in ("out", "net", "landed", "misjudged"))
    # Rallies of one stroke of A: won, lost, both, none told; by the winner where the score jumps; a contradiction each way.
    score = [[1, 0], [1, 1], [2, 2], [4, 2], [6, 2], [7, 2], [7, 3], [8, 3]]
    rows = raw("12345678", "11111111", "AAAAAAAA", score=score, winner=[1, 0, -1, 0, 1, -1, -1, 1],
               reason=[landed, out, landed, misjudged, net, net, landed, -1])  # fmt: skip
    outcome, reason = cleaning.outcomes(rows, cleaning.rally_starts(rows))
    assert outcome.tolist() == [2, 1, 3, 2, 1, 3, 3, 2]
    unknown = REASONS.index("unknown")
    assert reason.tolist() == [landed, out, unknown, misjudged, net, unknown, unknown, unknown]
    longer = raw("112", "121", "ABB", score=[[0, 0], [1, 0], [1, 1]], winner=[-1] * 3, reason=[-1, out, -1])
    outcome, reason = cleaning.outcomes(longer, cleaning.rally_starts(longer))
    assert (outcome.tolist(), reason.tolist()) == ([0, 1, 2], [0, out, unknown])


@pytest.mark.parametrize(
    ("met", "height", "shot", "unreliable"),
    [
        ("1111111111", "11111111000", 7, False), ("1111111111", "11111110000", 7, True),  # 7 and 6 of 10 agree
        ("11111-----", "10000000000", 7, False),  # five of eleven rows have both
        ("----------", "11111111110", 4, False), ("----------", "11111111100", 4, True),  # drops: above in 10 and 9 of 11
        ("----------", "0000000000-", 3, False), ("----------", "0000000001-", 3, False), ("----------", "0000000011-", 3, True),
    ],
)  # fmt: skip
def test_heights_contradict_each_other_or_the_shot_types(met: str, height: str, shot: int, unreliable: bool) -> None:
    heights = [np.array([-1 if c == "-" else int(c) for c in text]) for text in (met + "-", height)]
    rows: Any = SimpleNamespace(met_height=heights[0], height=heights[1], shot=np.full(11, shot))
    assert cleaning.heights_unreliable(rows, np.arange(11) == 0) == unreliable


def test_the_side_of_a_rally_is_that_of_most_of_its_points() -> None:
    nan = np.nan
    y: dict[str, Any] = {"player_location": [1, -1, 2, nan, 5, 5], "hit": [nan, -1, -1, nan, nan, nan],
         "opponent_location": [-1, 1, -1, nan, nan, -5], "landing": [-2, 2, 1, -1, 5, 5]}  # fmt: skip
    point: dict[str, Any] = {name: np.stack([np.zeros(6), values], axis=1) for name, values in y.items()}
    short = REASONS.index("short")
    rows = raw("111122", "123412", "ABABAB", shot=[0, 3, 4, 5, 0, -1], reason=[-1, -1, -1, -1, short, -1])
    rows.point = point
    side, contradicts = cleaning.sides(rows, cleaning.rally_starts(rows))
    assert side.tolist() == [1, -1, 1, -1, 1, -1], "unknown strokes do not vote; what fell short tells no side"
    assert contradicts.tolist() == [False, False, False, True, False, False], "the last stroke of B landed on B's side"


def test_labels_are_those_of_the_receiver() -> None:
    labels = np.arange(17)
    mirrored = {False: AREA_OF_LABEL, True: tuple(court.mirrored(np.array(AREA_OF_LABEL)).tolist())}
    below = np.stack([np.zeros(17), np.ones(17)], axis=1)
    for source, number, landing, own, turned in (
        ("ShuttleSet", 1, below, False, False), ("ShuttleSet", 1, below, True, True), ("ShuttleSet", 9, below, False, True),
        ("ShuttleSet", 20, below, False, True), ("ShuttleSet", 21, below, False, False), ("ShuttleSet", 9, -below, False, False),
        ("ShuttleSet22", 9, below, False, False), ("ShuttleSet", 9, below, True, False),
    ):  # fmt: skip
        match = SimpleNamespace(source=source, number=number)
        rows: Any = SimpleNamespace(label_area=labels, match=match, point={"landing": landing})
        found = cleaning.corrected_label(rows, np.full(17, own))
        assert found.tolist() == [-1, *mirrored[turned], *[-1] * 7], (source, number, own)


def cleaned(root: Path, rows: list[Row], *more: list[Row]) -> Cleaned:
    Layout(root).match("Viktor_AXELSEN _CHEN_Long_Malaysia_Masters_2020_ Finals", [rows, *more])
    return clean_matches(root)


def three(number: int, *, a_below: bool = True) -> list[Row]:
    return rally(number, "A", [SERVE, LIFT, SMASH], (number, 0), reason="對手落地致勝", winner="A", a_below=a_below)


@pytest.mark.parametrize(
    ("n", "odd", "games", "exchanged"), [(5, 1, 1, True), (10, 2, 1, True), (9, 2, 1, False), (5, 1, 3, False)]
)
def test_letters_are_exchanged_in_a_fifth_of_the_rallies_at_most(
    n: int, odd: int, games: int, exchanged: bool, tmp_path: Path
) -> None:
    whole_game = game(three(number) for number in range(1, n + 1))
    last = game(three(number, a_below=number > odd) for number in range(1, n + 1))
    strokes = cleaned(tmp_path, *[whole_game] * (games - 1), last).strokes
    players = strokes.filter(pa.compute.equal(strokes["game"], games))["player"].to_pylist()
    assert players[0] == ("chen-long" if exchanged else "viktor-axelsen")
    assert players[-1] == "viktor-axelsen"


@pytest.mark.parametrize(
    ("point", "y", "kept"),
    [("hit", 0.4, True), ("hit", 0.6, False), ("player_location", -0.1, True), ("player_location", 0.1, False),
     ("opponent_location", 0.1, True), ("opponent_location", -0.1, False)],
)  # fmt: skip
def test_points_where_nobody_can_be_are_unknown(point: str, y: float, kept: bool, tmp_path: Path) -> None:
    rows = game([three(1), three(2)])
    rows[2][f"{point}_x"], rows[2][f"{point}_y"] = pixel(0.3, -y)  # a point of A, who plays below
    name = {"hit": "contact", "player_location": "striker", "opponent_location": "receiver"}[point]
    result = cleaned(tmp_path, rows)
    assert result.account.dropped == {}
    assert result.strokes[f"{name}_y"][2].as_py() == (pytest.approx(y, abs=1e-3) if kept else None)


@pytest.mark.parametrize(("y", "reason", "dropped"), [(-0.4, "對手落地致勝", 0), (-0.6, "對手落地致勝", 1), (-0.6, "掛網", 0)])
def test_landings_on_the_own_side(y: float, reason: str, dropped: int, tmp_path: Path) -> None:
    rows = rally(1, "A", [SERVE, LIFT, SMASH], (1, 0) if reason != "掛網" else (0, 1), reason=reason)
    rows[2]["landing_x"], rows[2]["landing_y"] = pixel(0.3, -y)
    assert cleaned(tmp_path, rows).account.dropped.get("landing on the striker's side", 0) == dropped


def test_techniques_and_heights_of_raw_rows(tmp_path: Path) -> None:
    around, back = Hit("長球", -1.8, 6.1, height=1, around_head=True), Hit("挑球", 1.9, 6.0, backhand=True)
    rows = rally(1, "A", [SERVE, back, around, CLEAR], (0, 1), reason="出界", winner="B")
    rows[0]["hit_height"] = "1"
    rows[3]["backhand"] = rows[3]["aroundhead"] = "1"
    strokes = cleaned(tmp_path, rows).strokes
    assert strokes["technique"].to_pylist() == [0, 1, 2, 1]
    assert strokes["height"].to_pylist() == [0, 0, 1, 1], "serves are struck below the net"


# Readers of other formats.

HEADER = "rally,ball_round,player,type,aroundhead,backhand,hit_height,landing_area,lose_reason,getpoint_player," \
    "roundscore_A,roundscore_B,time,frame_num,server,hit_area,match_id,set\n"  # fmt: skip


def shuttleset(
    tmp_path: Path, *rows: str, name: str = "final.csv"
) -> tuple[dict[str, tuple[str, ...]], list[tuple[int | None, str]]]:
    path = tmp_path / name
    header = HEADER if rows[0].count(",") == HEADER.count(",") else HEADER.replace(",match_id,set", "")
    path.write_text(header + "\n".join(rows) + "\n")
    sheet = shuttleset_game.read(path, StrictCsv(path, ())).sheet
    return sheet.columns, [(warning.line, warning.message) for warning in sheet.warnings]


def test_rows_of_a_game_of_shuttleset(tmp_path: Path) -> None:
    columns, warnings = shuttleset(
        tmp_path,
        "1,1,A,發短球,,,2.0,7,,,1,0,0:01:05,300.0,1,,m,2.0",
        "1,2,B,挑球,,1,1,3,,,1,0,1:00:00,330,2,7,m,2.0",
        "1,3,A,,1,1,,16,掛網,B,1,0,x,,2,3,m,2.0",
        "2,1,C,長球,7,,3,17,未過網,,1,0,,,1,9,m,2.0",
        "2,2,A,長球,0,0.0,2,0,,,2,1,,,1,8,m,2.0",
    )
    assert columns["match"] == ("m",) * 5
    assert columns["game"] == ("2",) * 5
    assert columns["rally"] == ("1", "1", "1", "2", "2")
    assert columns["shot"] == ("發短球", "挑球", "unknown", "長球", "長球")
    assert columns["technique"] == ("forehand", "backhand", "around-the-head", "7", "forehand")
    assert columns["height"] == ("below", "above", "", "3", "below")
    areas = court.AREAS
    assert columns["area"] == (areas[AREA_OF_LABEL[6]], areas[AREA_OF_LABEL[2]], "", "", "")
    assert columns["points"] == ("1", "0", "1", "", "2")
    assert columns["points_opponent"] == ("0", "1", "0", "", "1")
    assert columns["seconds"] == ("65", "3600", "x", "", "")
    assert columns["frame"] == ("300", "330", "", "", "")
    assert columns["winner"] == ("", "", "B", "", "")
    assert warnings == [
        (6, "server '1'; expected 1 for the first stroke of a rally, and for no other"),
        (6, "hit_area is not the landing_area of the stroke before, which is used"),
    ]


@pytest.mark.parametrize(
    ("name", "match", "number"), [("set3.csv", None, "3"), ("set33.csv", "set33", "1"), ("final.csv", "final", "1")]
)
def test_the_name_of_a_file_tells_match_and_game(name: str, match: str | None, number: str, tmp_path: Path) -> None:
    columns, _ = shuttleset(tmp_path, "1,1,A,發短球,,,2,16,,,1,0,,,2,", name=name)
    assert (columns["match"], columns["game"]) == ((match or tmp_path.name,), (number,))
    assert columns["area"] == (court.AREAS[0],), "outside of the court the nearest one"


def point(before: tuple[int, int], game: tuple[int, int], *strokes: str, cause: str | None = None) -> dict[str, Any]:
    """A point of BadmintonDB; strokes as seat, type, and time."""
    rally = [{"Player": f"T{seat}P1" if seat != "?" else None, "StrokeType": kind, "StrokeBegin": float(time)}
             for seat, kind, time in (text.split("/") for text in strokes)]  # fmt: skip
    seats = {f"T{i + 1}P1": {"Point": before[i], "Score": game[i]} for i in (0, 1)}
    return {"PointInfo": {**seats, "Rally": rally, "WonEnd": None if cause is None else {"Cause": cause}}}


def test_points_of_badminton_db() -> None:
    points = [
        point((0, 0), (0, 0), "1/Serve/1", "2/Lift Bh/2", "1/Smash(Bh)/3.5", cause="end_miss"),
        point((1, 0), (0, 0), "1/Serve/9", "?/Lift/10", "2/*FAULT*/11", cause="end_out"),
        point((0, 0), (0, 1), "2/Serve/20", "1/Lift/21", cause="end_miss"),
    ]
    value = {f"Point{i}": each for i, each in enumerate(points)}
    assert badminton_db.recognises(value)
    assert badminton_db.recognises(points)
    others: list[Any] = [[], {}, [1], [{}], {"a": [1]}, "PointInfo", 3]
    assert not any(map(badminton_db.recognises, others))
    path = Path("2031-01-1F-WS-Ada ALPHA (ABC)-Bea BETA (XYZ)-Club Open-1080p.json")
    columns = badminton_db.read(path, b"", value).sheet.columns
    ada, bea = "Ada ALPHA", "Bea BETA"
    assert columns["player"] == (ada, bea, ada, ada, bea, bea, bea, ada)
    assert columns["opponent"] == (bea, ada, bea, bea, ada, ada, ada, bea)
    assert columns["shot"] == ("Serve", "Lift", "Smash", "Serve", "unknown", "unknown", "Serve", "Lift")
    assert columns["technique"] == ("forehand", "backhand", "backhand", *["forehand"] * 5)
    assert (columns["game"], columns["rally"]) == (("1",) * 6 + ("2",) * 2, ("1",) * 3 + ("2",) * 3 + ("1",) * 2)
    assert columns["stroke"] == ("1", "2", "3", "1", "2", "3", "1", "2")
    assert columns["ending"] == ("", "", "landed", "", "", "out", "", "landed")
    assert columns["winner"] == ("", "", ada, "", "", ada, "", ada)
    assert columns["points"] == ("1", "0", "1", "2", "0", "0", "0", "1"), "of the last points by their cause"
    assert columns["points_opponent"] == ("0", "1", "0", "0", "2", "2", "1", "0")
    assert columns["seconds"] == ("1.000", "2.000", "3.500", "9.000", "10.000", "11.000", "20.000", "21.000")
    assert columns["discipline"] == ("WS",) * 8
    assert "discipline" not in badminton_db.read(HERE, b"", points).sheet.columns


@pytest.mark.parametrize(
    ("cause", "seat", "after"),
    [("end_miss", 0, (4, 2)), ("end_miss", 1, (3, 3)), ("END_OUT", 0, (3, 3)), ("end_fault", 1, (4, 2)),
     ("end_misjudge", 1, (3, 3)),
     ("end_lucky", 0, (4, 2)), ("", 0, None), ("tea", 1, None), ("end_out", None, None)],
)  # fmt: skip
def test_the_score_after_the_cause_of_an_end(cause: str, seat: int | None, after: tuple[int, int] | None) -> None:
    strokes: list[tuple[int | None, float | None, str, int]] = [(0, 1.0, "Serve", 1), (seat, 2.0, "Lift", 2)]
    assert badminton_db.after_cause(Point(before=(3, 2), game=1, strokes=strokes, cause=cause)) == after
    assert badminton_db.after_cause(Point(before=(3, 2), game=1, cause="end_out")) is None


def test_points_of_elan_follow_the_scores() -> None:
    def tier(*texts: str) -> elan.Tier:
        return [elan.Annotation(float(start), float(end), value, 7) for start, end, value in (text.split("/") for text in texts)]

    scores = tier("0/10/0:0", "10/20/0 - 1", "20/30/1:1", "30/40/0:0")
    strokes = tier("1/2/Serve", "3/4/Lift", "5/6/END_MISS", "11/12/Serve", "13/14/error-tier", "15/16/Lift", "21/22/Serve",
                   "23/24/Lift", "25/26/end_out", "31/32/Serve", "99/99/late")  # fmt: skip
    found = elan._points(HERE, scores, strokes, [])
    assert [each.before for each in found] == [(0, 0), (0, 1), (1, 1), (0, 0)]
    assert [each.game for each in found] == [1, 1, 1, 2]
    assert [[stroke[0] for stroke in each.strokes] for each in found] == [[0, 1], [1, None, None], [0, 1], [0]]
    assert [each.cause for each in found] == ["END_MISS", "", "end_out", ""]
    assert found[0].strokes[1] == (1, 3.0, "Lift", 7)
    service = tier("0/10/T2P1S", "10/10/T1P1S", "20/20.5/T2P1S", "29/31/T2P1S")
    told = elan._points(HERE, scores, strokes, service)
    assert [each.strokes[0][0] for each in told] == [1, 0, 1, 1], "who serves, where it is said in a point"
    jump = tier("0/10/0:0", "10/20/0:2")
    for end, server in ((), 0), (("5/6/end_miss",), 1), (("5/6/end_out",), 0):
        later = elan._points(HERE, jump, tier("1/2/Serve", "3/4/Lift", *end, "11/12/Serve"), [])
        assert later[1].strokes[0][0] == server, "where the score jumps, the cause tells who serves"
    with pytest.raises(DataError, match=r"f, line 7: point '1-x'; expected the score before it"):
        elan._points(HERE, tier("0/1/1-x"), strokes, [])


def test_annotations_that_divide_another_one() -> None:
    def tier(*previous: str) -> Any:
        inside = "".join(
            f'<ANNOTATION><REF_ANNOTATION ANNOTATION_ID="{name}" ANNOTATION_REF="r" PREVIOUS_ANNOTATION="{before}">'
            f"<ANNOTATION_VALUE>{name} </ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>"
            for name, before in zip("abc", previous, strict=False)
        )
        return tree.parse_xml(HERE, f'<TIER TIER_ID="t">{inside}</TIER>'.encode())

    def found(*previous: str) -> tuple[list[Any], list[str]]:
        inferred: list[str] = []
        return elan._dependent(tier(*previous), {"r": elan.Annotation(10.0, 16.0, "", 1, "r")}, inferred), inferred

    three, told = found("", "a", "b")
    assert [each[:3] for each in three] == [(10, 12, "a"), (12, 14, "b"), (14, 16, "c")]
    assert told == ["times of 't': 3 annotations divide that of another one evenly"]
    assert [each[:3] for each in found("")[0]] == [(10, 16, "a")]
    assert found("")[1] == []
    for wrong in (("a",), ("", "b"), ("", "a", "a")):
        with pytest.raises(ValueError, match="tier 't' has annotations in another order than they follow each other"):
            found(*wrong)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16-le", "utf-16-be"])
def test_xml_is_recognised_in_each_encoding(encoding: str, tmp_path: Path) -> None:
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(encoding, b"")
    content = f"<file><ALL_INSTANCES>{instance(1, 2, 'smash')}</ALL_INSTANCES></file>"
    (tmp_path / "f").write_bytes(mark + content.encode(encoding))
    assert readers.read(tmp_path / "f", ColumnMap()).format == "Sportscode XML"


def test_other_files_are_recognised_by_their_content(tmp_path: Path) -> None:
    path = tmp_path / "f"
    for content, form in (
        (' [{"type": "smash"}]', "JSON of a video pipeline"),
        ("\ufeff{\"strokes\": [{\"type\": \"smash\"}]}", "JSON of a video pipeline"),
        ("player;shot\nAda;smash\n", "CSV"), (HEADER + "1,1,A,發短球" + "," * 14 + "\n", "ShuttleSet"),
    ):  # fmt: skip
        path.write_text(content)
        assert readers.read(path, ColumnMap()).format == form
    path.write_text("player;shot\nAda;smash\n")
    mapped = ColumnMap(columns={"player": "player", "shot": "shot"})
    with pytest.raises(DataError, match="missing column player, shot"):
        readers.read(path, mapped)  # a comma, unless the map says otherwise
    reading = readers.read(path, dataclasses.replace(mapped, delimiter=";"))
    assert (reading.sheet.columns["shot"], reading.strict, reading.source) == (("smash",), True, "own matches")


def instance(start: object, end: object, code: str, **labels: str) -> str:
    told = "".join(f"<label><group>{group.strip('_')}</group><text>{text}</text></label>" for group, text in labels.items())
    return f"<instance><start>{start}</start><end>{end}</end><code>{code}</code>{told}</instance>"


def test_instances_of_sportscode() -> None:
    inside = [
        instance(0, 100, "Game 1"), instance(10, 20, "Rally"), instance(21, 40, "Rally 2"),
        instance(22, 23, "Bea", Shot="lift", Area="rear left"), instance(11, 12, "smash", Player="Ada", Mood="calm", _="out"),
        instance(15.5, 15.6, "Player", Shot="drop", player="Bea"), instance(50, 51, "clear"), instance(60, 61, "Pause"),
        instance(70, 71, "Player", Shot="push"),
    ]  # fmt: skip
    content = f"<file><ALL_INSTANCES>{''.join(inside)}</ALL_INSTANCES></file>"
    reading = sportscode.read(HERE, b"", tree.parse_xml(HERE, content.encode()))
    columns = reading.sheet.columns
    assert columns["shot"] == ("smash", "drop", "lift", "clear", "push")
    assert columns["player"] == ("Ada", "Bea", "Bea", "", "")
    assert columns["game"] == ("1",) * 5
    assert columns["rally"] == ("1", "1", "2", "", "")
    assert columns["ending"] == ("out", "", "", "", "")
    assert columns["area"] == ("", "", "rear left", "", "")
    assert columns["seconds"] == ("11.000", "15.500", "22.000", "50.000", "70.000")
    assert reading.sheet.others == 4
    assert reading.lost[1] == "labels that are no columns here: 'Mood'"
    for wrong in ("x", "nan", "", "inf"):
        bad = f"<file><ALL_INSTANCES>{instance(1, wrong, 'smash')}</ALL_INSTANCES></file>".encode()
        with pytest.raises(DataError, match=f"end '{wrong}'; expected seconds"):
            sportscode.read(HERE, b"", tree.parse_xml(HERE, bad))


# Words.


def test_words_mean_what_most_of_the_file_means() -> None:
    assert bare(" Net-Shot_(1)\u2019s ") == "netshot1s"
    assert bare("\uff33mash") == "smash"
    assert (plain(" SMASH "), plain("4.0"), plain("4,00"), plain("4.5"), whole(" A ")) == ("smash", "4", "4", "4.5", "A")
    english, danish = Words("shot", ["smash", "clear"]), Words("shot", ["kort serv", "svipserv", "hopsmash"])
    assert (english.meaning("lob"), danish.meaning("kort serv"), english.meaning("no word")) == ("lift", "short-serve", None)
    indonesian = Words("shot", ["servis pendek", "smes", "netting"])
    assert indonesian.meaning("lob") == "clear"
    assert indonesian.ambiguous(" lob ") == "'lob' as clear, by the language of the file; in another: lift"
    assert english.ambiguous("smash") == ""
    assert Words("shot", [], ["Reli", "Pemain", "Pukulan"]).meaning("lob") == "clear", "headers tell the language too"
    assert english.meant("smahs") == "smash"
    assert english.meant("zzzz") is None
    assert english.meant("Schmetterbal", ["schmetterball"]) == "schmetterball"
    assert english.meant("s") is None


def columns_of(name: str, values: list[str], **own: str) -> tuple[list[int], list[str]]:
    sheet = sheet_of(HERE, b"", [{name: value} for value in values], range(2, 2 + len(values)))
    columns = Columns(sheet, ColumnMap(columns={name: name}, values={name: own} if own else {}), strict=True)
    return columns.codes(name, -7).tolist(), [problem.message for problem in sheet.problems]


def test_codes_of_words() -> None:
    assert columns_of("technique", ["bh", "", "FOREHAND", " "]) == ([1, -7, 0, -7], [])
    codes, problems = columns_of("shot", ["smash", "", "xx", "clear"], xx="drop")
    assert codes == [SHOTS.index("smash"), -7, SHOTS.index("drop"), SHOTS.index("clear")]
    assert [text.partition(";")[0] for text in problems] == ["unknown shot ''"]
    codes, problems = columns_of("side", ["near", "fra", "qq"])
    assert codes == [0, -7, -7]
    assert problems[1] == "unknown side 'qq'; map it in [values.side] to one of near, far"
    assert Columns(sheet_of(HERE, b"", [{"a": "1"}] * 2, [2, 3]), ColumnMap(), strict=True).codes("side", 5).tolist() == [5, 5]


# Players, rallies and results.


def table(*rows: str, columns: str = "rally,player,shot,ending") -> Cleaned:
    """A table of rows."""
    return import_text(columns + "\n" + "\n".join(rows) + "\n", "")


def said(*rows: str, columns: str = "rally,player,shot,ending", fields: str = "") -> str:
    """The first problem of a table, without the name of its file."""
    with pytest.raises(DataError) as caught:
        import_text(columns + "\n" + "\n".join(rows) + "\n", fields)
    return str(caught.value.problems[0]).partition("final")[2].removeprefix(", ")


@pytest.mark.parametrize(
    ("ending", "outcome", "reason", "forced"),
    [("out", 1, "out", None), ("net", 1, "net", None), ("short", 1, "short", None), ("foul", 1, "foul", None),
     ("error", 1, "unknown", None), ("forced-error", 1, "unknown", True), ("unforced-error", 1, "unknown", False),
     ("landed", 2, "landed", None), ("misjudged", 2, "misjudged", None), ("unknown", 3, "unknown", None)],
)  # fmt: skip
def test_endings_are_outcomes_and_reasons(ending: str, outcome: int, reason: str, forced: bool | None) -> None:
    strokes = table("1,Ada,short serve,", f"1,Bea,lift,{ending}").strokes
    assert strokes["outcome"].to_pylist() == [0, outcome]
    assert [REASONS[code] for code in strokes["reason"].to_pylist()] == ["returned", reason]
    assert strokes["forced"].to_pylist() == [None, forced]


WON = "rally,player,shot,ending,winner"


def test_winners_and_endings_agree() -> None:
    fine = table("1,Ada,short serve,,", "1,Bea,lift,out,Ada", "2,Ada,short serve,,Bea", "2,Bea,lift,landed,", columns=WON)
    assert fine.strokes["outcome"].to_pylist() == [0, 1, 0, 2]
    assert fine.warnings == ()
    assert said("1,Ada,short serve,,", "1,Bea,lift,out,Bea", columns=WON) == "line 3: ending 'out' contradicts who won the rally"
    assert (
        said("1,Ada,short serve,,", "1,Bea,lift,landed,Ada", columns=WON)
        == "line 3: ending 'landed' contradicts who won the rally"
    )
    assert (
        said("1,Ada,short serve,,Ada", "1,Bea,lift,,Bea", columns=WON) == "line 3: 'Bea' contradicts another winner of this rally"
    )
    assert said("1,Ada,short serve,out,", "1,Bea,lift,out,", columns=WON).endswith(
        "of a stroke that is not the last of its rally"
    )
    assert "neither an ending nor a winner" in said("1,Ada,short serve,,", "1,Bea,lift,,", columns=WON)
    only = table("1,Ada,short serve,,", "1,Bea,lift,,Ada", columns=WON)
    assert only.strokes["outcome"].to_pylist() == [0, Outcome.FAULT]
    assert [text.partition(": ")[2] for text in only.warnings] == ["the last stroke of its rally has no ending, only a winner"]


def test_who_serves_next_tells_who_won() -> None:
    rows = [
        "1,Ada,short serve",
        "1,Bea,lift",
        "2,Bea,short serve",
        "2,Ada,lift",
        "3,Bea,short serve",
        "5,Ada,short serve",
        "5,Bea,drop",
    ]
    found = table(*rows, columns="rally,player,shot")
    assert found.strokes["outcome"].to_pylist() == [0, 2, 0, 1, 3, 0, 3], "the rally after the third is not there"
    inferred = [("outcome" in (text or "").split()) for text in found.strokes["inferred"].to_pylist()]
    assert inferred == [False, True, False, True, False, False, False]
    assert found.provenance["inferred"][0].startswith("the discipline: MS; if it is another")
    assert "who won the rallies, from who serves next: 2 of 7 strokes" in found.provenance["inferred"]
    assert found.provenance["lost"][0] == "areas of strokes without a known reply: 3 of 7"


def test_a_rally_begins_with_a_serve_or_after_a_pause() -> None:
    strokes = [
        ("serve", 0.0),
        ("lift", 1.0),
        ("smash", 5.0),
        ("lift", 9.5),
        ("drop", 10.5),
        ("short serve", 11.5),
        ("smash", 12.5),
    ]
    value = [{"type": shot, "time": time, "player": "Ada" if i % 2 else "Bea"} for i, (shot, time) in enumerate(strokes)]
    found = import_text(json.dumps(value))
    rows = found.strokes.to_pylist()
    assert [(row["rally"], row["stroke"]) for row in rows] == [(1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 1), (3, 2)]
    assert SHOTS[rows[0]["shot"]] == "short-serve", "a lift is no reply to a long serve"
    assert "where rallies begin: with each serve, or after a pause of 4 s" in found.provenance["inferred"]


def test_lets_do_not_count_in_their_game() -> None:
    def rally(game: int, number: int, ending: str) -> list[str]:
        return [f"{game},{number},Ada,short serve,", f"{game},{number},Bea,lift,{ending}"]

    rows = [
        *rally(1, 1, "let"),
        *rally(1, 2, "out"),
        *rally(2, 1, "out"),
        *rally(2, 2, "let"),
        *rally(2, 3, "out"),
        *rally(2, 4, "out"),
    ]
    found = table(*rows, columns="game,rally,player,shot,ending")
    assert found.account.dropped == {"let": 4}
    numbers = list(zip(found.strokes["game"].to_pylist(), found.strokes["rally"].to_pylist(), strict=True))
    assert numbers[::2] == [(1, 1), (2, 1), (2, 2), (2, 3)]
    same = table(*[row.replace("2,3", "2,2").replace("2,4", "2,3") for row in rows], columns="game,rally,player,shot,ending")
    assert same.strokes["rally"].to_pylist() == found.strokes["rally"].to_pylist(), "a replay may have the number of its let"


def test_a_match_has_two_players() -> None:
    assert said("1,Ada,short serve,", "1,Bea,lift,out", "2,Ada,short serve,", "2,Cleo,lift,out") == (
        "line 5: match 'final' has 3 players (ada, bea, cleo); expected two, or a column opponent"
    )
    assert "has 1 players (ada)" in said("1,Ada,short serve,out")
    both = "rally,player,opponent,shot,ending"
    found = table("1,Ada,Bea,short serve,", "1,Bea,Ada,lift,out", columns=both)
    assert found.strokes["opponent"].to_pylist() == ["bea", "ada"]
    assert "player and opponent differ" in said("1,Ada,Ada,short serve,out", columns=both)
    hands = "rally,player,hand,shot,ending"
    told = table("1,Ada,left,short serve,", "1,Bea,,lift,out", "2,Ada,,short serve,out", columns=hands).strokes
    assert told["hand"].to_pylist() == [1, None, 1]
    assert receiver_hands(told).tolist() == [-1, 1, -1]
    assert said("1,Ada,left,short serve,", "1,Bea,right,lift,out", "2,Ada,right,short serve,out", columns=hands) == (
        "line 4: ada is right-handed here, and not above; expected one hand"
    )


def test_the_discipline_is_that_of_known_players() -> None:
    def rows(one: str, other: str) -> list[str]:
        return [f"1,{one},short serve,", f"1,{other},lift,out"]

    assert table(*rows("Viktor Axelsen", "Ada")).strokes["discipline"].to_pylist() == ["MS", "MS"]
    assert table(*rows("AN Se Young", "Ada")).strokes["discipline"].to_pylist() == ["WS", "WS"]
    assert "players of different ones" in said(*rows("AN Se Young", "Viktor Axelsen"))
    warned = import_text("rally,player,shot,ending\n" + "\n".join(rows("Viktor Axelsen", "Ada")), 'discipline = "WS"\n')
    assert warned.strokes["discipline"].to_pylist() == ["WS", "WS"]
    assert any("a player of the published matches, who plays another discipline" in text for text in warned.warnings)
    column = "rally,player,shot,ending,discipline"
    found = table("1,Ada,short serve,,WS", "1,Bea,lift,out,WS", columns=column)
    assert found.strokes["discipline"].to_pylist() == ["WS", "WS"]
    mapped = '[columns]\nrally = "rally"\nplayer = "player"\nshot = "shot"\nending = "ending"\n'
    assert said(*rows("Ada", "Bea"), fields=mapped).startswith("line 2: unknown discipline")


def test_what_is_inferred_of_a_stroke_is_named() -> None:
    found = table("1,Ada,serve,", "1,Bea,lift,", "1,Ada,smash,landed", "2,Ada,serve,", "2,Bea,smash,out")
    rows = found.strokes.to_pylist()
    assert [SHOTS[row["shot"]] for row in rows[::3]] == ["short-serve", "long-serve"]
    assert [row["height"] for row in rows] == [0, 0, 1, 0, 1]
    assert [row["inferred"] for row in rows] == [
        "shot technique area", "height technique area", "height technique", "shot technique area", "height technique"
    ]  # fmt: skip
    assert [None if row["area"] is None else court.AREAS[row["area"]] for row in rows] == [
        "front-centre", "back-centre", None, "back-centre", None
    ]  # fmt: skip
    assert [row["confidence"] for row in rows] == [pytest.approx(0.3), pytest.approx(0.25), None, pytest.approx(0.25), None]
    assert found.account.as_json()["strokes"] == {"total": 5, "kept": 5}


def test_a_broken_rally_of_a_program_is_dropped() -> None:
    def stroke(rally: int, player: str, shot: str) -> dict[str, Any]:
        return {"rally": rally, "player": player, "type": shot}

    value = [stroke(1, "Ada", "short serve"), stroke(1, "Bea", "lift"), stroke(2, "Ada", "short serve"),
             stroke(2, "Bea", "somersault"), stroke(2, "Ada", "drop"),
             stroke(3, "Bea", "short serve"), stroke(3, "Ada", "drop")]  # fmt: skip
    found = import_text(json.dumps(value))
    assert found.account.dropped == {"broken rally": 3}
    assert (found.account.rallies, found.account.rallies_kept, found.account.strokes) == (3, 2, 7)
    assert found.strokes["rally"].to_pylist() == [1, 1, 3, 3]
    assert any("unknown shot 'somersault'" in text for text in found.warnings)


# Tables.


def test_pseudonyms_follow_the_hashes_of_names() -> None:
    strokes = read_matches(SAMPLE)
    found = anonymised(strokes.replace_schema_metadata({**strokes.schema.metadata, b"shuttle_marl.provenance": b"{}"}))
    for columns, form in ((("player", "opponent"), "player-{:02d}"), (("match",), "match-{:03d}")):
        names = sorted(set(strokes[columns[0]].to_pylist()), key=lambda name: content_hash(name.encode()))
        for column in columns:
            expected = [form.format(1 + names.index(name)) for name in strokes[column].to_pylist()]
            assert found[column].to_pylist() == expected
    assert b"shuttle_marl.provenance" not in found.schema.metadata
    assert found.schema.metadata[b"version"] == strokes.schema.metadata[b"version"]
    assert found.drop_columns(["player", "opponent", "match"]).equals(strokes.drop_columns(["player", "opponent", "match"]))


def test_names_of_codes() -> None:
    strokes = read_matches(SAMPLE).slice(0, 30)
    found = named(strokes)
    for name, names in NAMES.items():
        codes = strokes[name].to_pylist()
        assert found[name].to_pylist() == [None if code is None else names[code] for code in codes]
    assert found.column_names == strokes.column_names
    played = [rules.FAULT, rules.WINNER, rules.RETURNED_BELOW, rules.RETURNED_ABOVE]
    assert outcome_of(np.array(played)).tolist() == [1, 2, 0, 0]


# Folders of the published data.


def publish(root: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Take the files of a folder for the published ones; the match one is of the train split, two of the test split."""
    found = {path.relative_to(root).as_posix(): content_hash(path.read_bytes()) for path in sorted(root.rglob("*.csv"))}
    monkeypatch.setattr(upstream, "manifest", lambda: found)
    monkeypatch.setattr("shuttle_marl.data.table.split_of", {"one": "train", "two": "test"}.get)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    layout = Layout(tmp_path)
    layout.match("one", [plain_game(4), plain_game(2)])
    layout.match("two", [plain_game(2)], number=2)
    return tmp_path


def test_a_whole_folder_is_sound(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    published = publish(folder, monkeypatch)
    report = validate(folder)
    assert (report.problems, report.notes) == ((), ())
    assert report.splits == {"train": (2, 2), "validation": (0, 0), "test": (1, 1)}
    assert report.account is not None
    assert (report.account.matches, report.account.rallies, report.account.strokes) == (2, 8, 13 + 6 + 6)
    cleaned = clean_matches(folder)
    told = provenance_of(folder, cleaned)
    games = [(name, digest) for name, digest in published.items() if "/set" in name.removeprefix("ShuttleSet/set")]
    content = b"".join(f"{name}\n".encode() + bytes.fromhex(digest) for name, digest in games)
    assert (told["files"], told["sha256"]) == (3, content_hash(content))
    assert clean_matches(folder, ["two"]).account.strokes == 6
    with pytest.raises(DataError, match="no files of four, three; get them with"):
        clean_matches(folder, ["three", "one", "four"])


def test_files_are_missing_only_where_their_split_is_wanted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    publish(folder, monkeypatch)
    shutil.rmtree(folder / "ShuttleSet/set/two")
    some = validate(folder, ["train"])
    assert (some.problems, some.splits["test"]) == ((), (0, 1))
    assert some.account is not None
    assert some.account.matches == 1
    [problem] = validate(folder, ["train", "test"]).problems
    assert problem.message.startswith("missing set1.csv (test split); download them with ")
    (folder / "ShuttleSet/set/homography.csv").unlink()
    found = validate(folder, ["train"])
    assert [problem.message.partition(" ")[0] for problem in found.problems] == ["missing", "cannot"]
    assert "(train split)" not in found.problems[0].message, "the lists are of no split"
    assert found.account is None
    (folder / "ShuttleSet/set/one/set2.csv").rename(folder / "ShuttleSet/set/one/set3.csv")
    assert validate(folder, []).splits["train"] == (1, 2)


def test_wrong_values_of_published_files_are_notes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = folder / "ShuttleSet/set/two/set1.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("殺球", "飛球", 1), encoding="utf-8")
    publish(folder, monkeypatch)
    report = validate(folder)
    assert report.problems == ()
    [note] = report.notes
    assert note.endswith("(in the published file: the row is dropped)")
    assert "unknown type '飛球'" in note
    assert report.account is not None
    assert report.account.dropped == {"unreadable value": 1}
    path.write_text(path.read_text(encoding="utf-8").replace("殺球", "飛球", 1) + "\n", encoding="utf-8")
    altered = validate(folder)
    assert altered.account is None
    assert altered.notes == ()
    assert altered.problems[0].message.startswith("altered: SHA-256 is ")
    assert sum("unknown type" in problem.message for problem in altered.problems) >= 1
    assert altered.splits["test"] == (0, 1)


def test_games_of_a_match_are_those_that_are_listed(folder: Path) -> None:
    (folder / "ShuttleSet/set/one/set2.csv").rename(folder / "ShuttleSet/set/one/set3.csv")
    with pytest.raises(DataError, match=r"match.csv lists 2 games, files set1.csv, set2.csv, …; present: set1.csv, set3.csv"):
        clean_matches(folder)
    (folder / "ShuttleSet/set/one/set3.csv").rename(folder / "ShuttleSet/set/one/set2.csv")
    (folder / "ShuttleSet/set/one/settings.csv").touch()
    assert clean_matches(folder).account.matches == 2
