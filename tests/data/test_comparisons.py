"""Inferences and comparisons of an import, row by row: times, scores, orders of rallies, points and heights."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.data import inference
from shuttle_marl.data.inference import (
    MET,
    areas_met,
    changes,
    check_scale,
    check_tempo,
    compare,
    read_score,
    warn_alike,
    winners_by_score,
)
from shuttle_marl.data.schema import REASONS
from shuttle_marl.data.strict_csv import Problem, Sheet
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES

NAN = float("nan")


def sheet_of(n: int, **columns: list[str]) -> Sheet:
    """A table of n rows on the lines 2, 3, and so on."""
    sheet = Sheet(Path("f.csv"), b"")
    columns = columns or {"a": [""] * n}
    sheet.fill(list(columns), list(zip(*columns.values(), strict=True)), range(2, n + 2))
    return sheet


def told(sheet: Sheet) -> tuple[list[tuple[int | None, str]], list[tuple[int | None, str]]]:
    """Warnings and problems, as line and first words."""
    warnings, problems = ([(each.line, each.message) for each in found] for found in (sheet.warnings, sheet.problems))
    return warnings, problems


def compared(*rows: str, headers: tuple[str, ...] = (), times: list[str] | None = None, **columns: Any) -> Any:
    """Warnings and problems of rows of match, game, rally, stroke, player and outcome (r, f, w, u), of players A and B."""
    n = len(rows)
    fields = list(zip(*(row.split() for row in rows), strict=True))
    player = np.array(fields[4], dtype=object)
    strokes: dict[str, Any] = {
        "match": np.array(fields[0]),
        **{name: np.array(values, dtype=np.int64) for name, values in zip(("game", "rally", "stroke"), fields[1:4], strict=True)},
        "player": player,
        "opponent": np.where(player == "A", "B", "A").astype(object),
        "outcome": np.array(["rfwu".index(letter) for letter in fields[5]]),
        "reason": np.zeros(n, np.int64),
        "shot": np.where(np.array(fields[3]) == "1", 0, SHOTS.index("drive")),
        "height": np.zeros(n, np.int64),
        "points": np.full(n, NAN),
        "points_opponent": np.full(n, NAN),
    }
    points = {name: np.full((n, 2), NAN) for name in inference.POINTS}
    for name, values in columns.items():
        (points if name in points else strokes)[name] = np.array(values)
    side = strokes.pop("side", np.zeros(n, np.int64))
    sheet = sheet_of(n, seconds=times or [""] * n)
    compare(sheet, {name: name for name in headers}, strokes, points, side)
    return told(sheet)


def test_where_a_stroke_was_met_is_told_by_type_and_technique_of_its_reply() -> None:
    shots = list(MET)
    reply = np.array([SHOTS.index(name) for name in shots for _ in range(4)] + [-1, len(SHOTS), len(SHOTS) + 1, 0, 1])
    technique = np.array([-1, *range(len(TECHNIQUES))] * len(shots) + [0] * 5)
    area, share = areas_met(reply, technique)
    entries = [entry for name in shots for entry in MET[name]]
    assert [(AREAS[a], s) for a, s in zip(area[:-5], share, strict=False)] == entries
    assert area[-5:].tolist() == [-1] * 5
    assert np.isnan(share[-5:]).all()
    assert {name: 0 < s < 1 for name, s in entries} == dict.fromkeys([name for name, _ in entries], True)


@pytest.mark.parametrize(
    ("text", "points"),
    [("5-3", (5, 3)), ("21 : 19", (21, 19)), ("0/0", (0, 0)), ("1\u20142", (1, 2)), (" 7 8 ", (7, 8)),
     ("\uff15\uff0d\uff13", (5, 3)), ("100-3", None), ("5-100", None), ("5", None), ("", None), ("5--3", None),
     ("a5-3", None), ("5-3x", None)],
)  # fmt: skip
def test_scores_as_people_write_them(text: str, points: tuple[int, int] | None) -> None:
    assert read_score(text) == points


def reading_of(*scores: tuple[int, int] | None, server: str, told: str | None = None, games: str | None = None, began: str = "",
               match: str = "") -> Any:  # fmt: skip
    """Scores and winners; servers and told winners as digits, a dash for unknown, ``games`` the number of each rally's game."""
    n = len(scores)
    fresh = changes(np.array(list(games or "1" * n)))
    numbers = [
        np.array([-1 if c == "-" else int(c) for c in text or "0" * n]) for text in (server, told or "-" * n, began, match)
    ]
    return winners_by_score(list(scores), fresh, *numbers)


def test_a_score_after_the_rally_and_one_before_it() -> None:
    # 0 serves and wins, 1 wins, 1 wins: only the winners determine whose number is first.
    after, won, words = reading_of((1, 0), (1, 1), (1, 2), server="001", told="011")
    assert (after, won.tolist()) == ([(1, 0), (1, 1), (1, 2)], [0, 1, 1])
    assert words == "the score is that after the rally; the first number is the first striker's"
    after, won, words = reading_of((0, 1), (1, 1), (2, 1), server="001", told="011")
    assert (after, won.tolist()) == ([(1, 0), (1, 1), (1, 2)], [0, 1, 1])
    assert words == "the score is that after the rally; the first number is the other player's"
    after, won, words = reading_of((0, 0), (1, 0), (1, 1), server="001", told="01-")
    assert (after, won.tolist()) == ([(1, 0), (1, 1), None], [0, 1, -1])
    assert words == "the score is that before the rally; the first number is the first striker's"
    assert reading_of((0, 0), (1, 0), (1, 1), server="001", told="011")[0] == [(1, 0), (1, 1), (1, 2)], "told, not read"
    # Before each rally, the server's number first: 0 wins, 0 wins, 1 wins, 1 serves at 1-2.
    after, won, words = reading_of((0, 0), (1, 0), (2, 0), (1, 2), server="0001", told="001-")
    assert (after, won.tolist()) == ([(1, 0), (2, 0), (2, 1), None], [0, 0, 1, -1])
    assert words == "the score is that before the rally; the first number is the server's"


def test_a_gap_in_the_scores_and_a_new_game_tell_no_winner() -> None:
    after, won, _ = reading_of((1, 0), None, (2, 1), (3, 1), (4, 2), server="00000", told="0--0-")
    assert after == [(1, 0), None, (2, 1), (3, 1), (4, 2)]
    assert won.tolist() == [0, -1, -1, 0, -1], "a jump by two tells nothing"
    after, won, _ = reading_of((1, 0), (2, 0), (1, 0), (1, 1), server="0001", told="0001", games="1122")
    assert won.tolist() == [0, 0, 0, 1]
    assert after == [(1, 0), (2, 0), (1, 0), (1, 1)]
    before, won, _ = reading_of((0, 0), (1, 0), (0, 0), (1, 0), server="0000", told="0-0-", games="1122")
    assert before == [(1, 0), None, (1, 0), None]
    assert won.tolist() == [0, -1, 0, -1], "the last rally of a game is not followed by a score of that game"


def test_scores_that_several_readings_fit_are_not_read() -> None:
    assert reading_of((1, 0), (2, 0), server="00")[2] == "", "of either player"
    assert reading_of((1, 0), (2, 0), server="00", told="00")[2] != ""


def test_the_first_number_may_be_of_one_player_in_each_match() -> None:
    # In the second game of each match the other player strikes first; in match 1 the first number is of who did not begin it.
    scores = [(1, 0), (2, 0), (1, 0), (1, 1), (0, 1), (0, 2), (0, 1), (1, 1)]
    after, won, words = reading_of(
        *scores, server="00010001", told="00100010", games="11223344", began="00110011", match="00001111"
    )
    assert words == "the score is that after the rally; the first number is one player's in each match"
    assert won.tolist() == [0, 0, 1, 0, 0, 0, 1, 0]
    assert after == [(1, 0), (2, 0), (0, 1), (1, 1), (1, 0), (2, 0), (0, 1), (1, 1)]


@pytest.mark.parametrize(
    ("times", "certain", "says"),
    [
        ([], None, ""), ([NAN], None, ""), ([0.3, 0.3], None, ""), ([5.0], None, ""), ([0.29], False, "0.29 s: are these"),
        ([5.1], True, "5.1 s: are these seconds?; write seconds, or leave the times out"), ([0.1], False, "after 0.1 s"),
        ([0.09], True, "after 0.09 s"), ([0.0, 0.0, 9.0], False, "after 0 s"), ([0.0, 1.0, 900.0, NAN], None, ""),
    ],
)  # fmt: skip
def test_the_median_time_between_strokes(times: list[float], certain: bool | None, says: str) -> None:
    sheet = sheet_of(2)
    for _ in range(2):
        check_tempo(sheet, np.array(times))
    found = sheet.problems if certain else sheet.warnings
    assert len(sheet.problems) + len(sheet.warnings) == (certain is not None), "told once"
    assert all(says in each.message for each in found)
    assert certain is None or (len(found) == 1 and "leave the times out" in found[0].message) == certain


@pytest.mark.parametrize(
    ("n", "most", "kind"),
    [(2, 1.0, ""), (3, 1.0, "warning"), (3, 1.06, ""), (5, 1.06, ""), (6, 1.06, "warning"), (6, 3.0, "warning"), (6, 3.01, ""),
     (9, 1.0, "warning"), (10, 1.05, "problem"), (10, 1.06, "warning"), (10, 3.01, "")],
)  # fmt: skip
def test_points_close_to_the_net_are_no_metres(n: int, most: float, kind: str) -> None:
    points = np.full((n + 1, 2), 0.5)
    points[0, n % 2] = -most
    points[n] = NAN  # does not count
    points[1, 1] = NAN  # counts by its other coordinate
    sheet = sheet_of(n)
    check_scale(sheet, "landing", points)
    assert (len(sheet.problems), len(sheet.warnings)) == (kind == "problem", kind == "warning")
    for each in (*sheet.problems, *sheet.warnings):
        assert each.message.startswith(f"all {n} landing points lie within {'3' if n > 5 else '1.05'} m of the middle of the net")


def test_rows_that_differ_from_the_row_before() -> None:
    assert changes(np.array([1, 1, 2, 2, 2]), np.array([5, 5, 5, 6, 6])).tolist() == [True, False, True, True, False]
    assert changes(np.array([3])).tolist() == [True]


def test_names_that_are_alike_are_told_once_and_at_their_first_row() -> None:
    seen: dict[str, str] = {}
    sheet = sheet_of(6)
    warn_alike(sheet, seen, ["Ada Li", "Ada Li", "Li \u00c1da", "Bea Beta", "Ada Lee", "Li \u00c1da"], "player")
    assert told(sheet)[0] == [(4, "'Li \u00c1da' and 'Ada Li' are alike: are they one player?")]
    other = sheet_of(3)
    warn_alike(other, seen, ["Ada Li", "ada li", "Ada \u0416"], "player")
    assert told(other)[0] == [(4, "player 'Ada \u0416' mixes letters of cyrillic and latin")], "equal identifiers are one player"
    matches = sheet_of(3)
    warn_alike(matches, {}, ["a b", "b a", "A b"], "match")
    assert told(matches)[0] == [(4, "'A b' and 'a b' are alike: are they one match?")], "words of a match have an order"


def test_missing_strokes_rallies_and_games_are_told_where_they_are_missing() -> None:
    rows = [
        "m 1 1 1 A r",
        "m 1 1 2 B f",
        "m 1 2 1 A r",
        "m 1 2 3 A f",
        "m 1 4 1 B u",
        "m 1 4 2 A u",
        "m 3 2 2 A r",
        "n 2 1 1 B r",
    ]
    warnings, problems = compared(*rows, headers=("stroke",))
    strokes, rallies, games = (f"{name} are missing before this one" for name in (
        "strokes of the rally", "rallies of the game", "games of the match"))  # fmt: skip
    assert warnings == [(5, strokes), (8, strokes), (6, rallies), (8, rallies), (8, games), (9, games)]
    assert problems == []
    assert (5, strokes) not in compared(*rows)[0], "counted strokes are not compared"


@pytest.mark.parametrize(
    ("end", "following", "says"),
    [
        ("A w", "1 2 1 A", False), ("A w", "1 2 1 B", True), ("A f", "1 2 1 B", False), ("A f", "1 2 1 A", True),
        ("A u", "1 2 1 B", False), ("A r", "1 2 1 B", False),  # not known who won
        ("A w", "1 3 1 B", False), ("A w", "1 2 2 B", False), ("A w", "2 1 1 B", False),
    ],
)  # fmt: skip
def test_who_won_serves_next(end: str, following: str, says: bool) -> None:
    found = compared(f"m 1 1 1 {end}", f"m {following} r")[0]
    assert ((3, "the server did not win the rally before") in found) == says


def test_players_stay_on_their_sides() -> None:
    rows = ["m 1 1 1 A r", "m 1 1 2 B f", "m 1 2 1 B r", "m 1 2 2 A f", "m 2 1 1 A r", "m 3 1 1 B f", "m 3 2 1 A r"]
    fine = compared(*rows, headers=("side",), side=[0, 1, 1, 0, 1, 0, 1])
    assert fine[1] == []
    assert not any("sides" in text for _, text in fine[0]), "the ends may change between games"
    warnings, problems = compared(*rows, headers=("side",), side=[0, 0, 1, 0, 1, 0, 0])
    assert problems == [(3, "the players are not on the sides of the stroke before")]
    moved = "the players change sides during the game"
    assert [line for line, text in warnings if text == moved] == [4], "in the third game they do"
    assert compared(*rows, side=[0, 0, 1, 0, 1, 0, 0])[1] == [], "without a column nothing is compared"


def test_times_do_not_fall() -> None:
    rows = ["m 1 1 1 A r", "m 1 1 2 B f", "m 1 2 1 A r", "m 1 2 2 B f", "m 2 1 1 A r", "m 2 1 2 B r"]
    warnings, problems = compared(*rows, headers=("seconds",), times=["10", "11", "9", "8", "1", "1"])
    assert [(line, text) for line, text in warnings if "before that" in text] == [
        (4, "the time is before that of the rally before")
    ]
    assert problems == [(5, "the time is before that of the stroke before")], "a game may begin at 0"
    assert any("half of the strokes" in text for _, text in warnings), "-1, 0 and 1 s: their median is 0"
    assert compared(*rows, times=["10", "11", "9", "8", "1", "1"])[1] == []


def scored(*scores: str, numbers: str = "", outcomes: str = "") -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Warnings and problems of rallies of one stroke of A, with the points of A and B after each."""
    n = len(scores)
    rows = [f"m 1 {rally} 1 A {outcome}" for rally, outcome in zip(numbers or range(1, n + 1), outcomes or "u" * n, strict=True)]
    points = [[NAN if part == "x" else float(part) for part in score.split(":")] for score in scores]
    found = compared(*rows, points=[a for a, _ in points], points_opponent=[b for _, b in points])
    warnings, problems = ([(line, text.partition(" before")[0]) for line, text in each if "score" in text] for each in found)
    return warnings, problems


@pytest.mark.parametrize(
    ("scores", "options", "warnings", "problems"),
    [
        (["1:0", "1:1"], {}, [], []),
        (["1:0", "1:2"], {}, [], ["score 1:2 after 1:0, 1 rallies"]),  # two points in one rally
        (["1:0", "0:1"], {}, [], ["score 0:1 after 1:0, 1 rallies"]),  # one point less
        (["1:0", "1:0"], {}, ["score 1:0 after 1:0, 1 rallies"], []),
        (["1:0", "2:1"], {"numbers": "13"}, [], []),  # two rallies later
        (["1:0", "2:0"], {"numbers": "13"}, ["score 2:0 after 1:0, 2 rallies"], []),
        (["1:0", "x:x", "2:1"], {}, [], []),
        (["1:0", "1:x", "3:1"], {}, [], ["score 3:1 after 1:0, 2 rallies"]),
        (["1:0", "2:0"], {"outcomes": "ww"}, [], []),
        (["1:0", "2:0"], {"outcomes": "wf"}, [], ["score 2:0 after 1:0, 1 rallies"]),
        (["0:1", "0:2"], {"outcomes": "ff"}, [], []),
        (["0:1", "0:2"], {"outcomes": "fw"}, [], ["score 0:2 after 0:1, 1 rallies"]),
        (["1:0", "1:0"], {"outcomes": "ww"}, [], ["score 1:0 after 1:0, 1 rallies"]),
    ],
)
def test_scores_follow_each_other(scores: list[str], options: dict[str, str], warnings: list[str], problems: list[str]) -> None:
    assert scored(*scores, **options) == (
        [(len(scores) + 1, text) for text in warnings],
        [(len(scores) + 1, text) for text in problems],
    )


def test_the_score_of_a_rally_is_that_of_its_last_stroke_and_begins_again_in_each_game() -> None:
    rows = ["m 1 1 1 A r", "m 1 1 2 B w", "m 2 1 1 B r", "m 2 1 2 A w", "n 2 1 1 A w"]
    fine = compared(*rows, points=[0, 1, 0, 1, 1], points_opponent=[1, 0, 1, 0, 0])
    assert ([text for _, text in fine[0] if "score" in text], fine[1]) == ([], [])
    wrong = compared(*rows, points=[1, 1, NAN, 1, 1], points_opponent=[0, 0, NAN, 0, 0])
    assert [line for line, text in wrong[0] if text == inference.OTHER_SCORE] == [2], "as the other player has it; a gap is none"


def test_contact_points_lie_where_the_shuttle_was_met_and_near_the_striker() -> None:
    rows = ["m 1 1 1 A r", "m 1 1 2 B r", "m 1 1 3 A w", "m 1 2 1 A r"]
    landing = [[1.0, 4.0], [-1.0, 5.0], [0.0, 3.0], [0.0, 3.0]]
    near = compared(*rows, landing=landing, contact=[[NAN] * 2, [-1.0, -3.5], [1.0, -5.5], [9.0, -9.0]],
                    striker=[[NAN] * 2, [-1.0, -7.5], [1.3, -5.0], [9.0, -9.0]])  # fmt: skip
    assert near == ([], []), "0.5 m and 4 m are not too far"
    far = compared(*rows, landing=landing, contact=[[NAN] * 2, [-1.0, -3.4], [1.3, -5.5], [9.0, -9.0]],
                   striker=[[NAN] * 2, [-1.0, -7.5], [1.0, -5.0], [9.0, -4.9]])  # fmt: skip
    met, striker = "where the stroke before was met", "the striker"
    assert [(line, text.rpartition(" from ")[2]) for line, text in far[0]] == [(3, met), (4, met), (3, striker), (5, striker)]
    assert [text.split(" from ")[0] for _, text in far[0]] == [
        f"the contact point is more than {m} m" for m in ("0.5", "0.5", "4", "4")
    ]


@pytest.mark.parametrize(
    ("outcome", "reason", "y", "says"),
    [
        ("f", "out", 6.6, "out, and the landing point lies in court"), ("f", "out", 6.8, ""), ("f", "unknown", 6.6, ""),
        ("f", "net", 0.6, "net or short, and the landing point lies beyond the net"), ("f", "net", 0.5, ""),
        ("f", "short", 0.6, "net or short, and the landing point lies beyond the net"), ("f", "short", -2.0, ""),
        ("f", "out", NAN, ""), ("w", "landed", NAN, ""), ("w", "landed", 6.6, ""), ("f", "foul", 0.6, ""),
        ("w", "landed", 6.8, "a winner, and the landing point lies outside the court"), ("u", "unknown", 6.8, ""),
    ],
)  # fmt: skip
def test_landings_agree_with_endings(outcome: str, reason: str, y: float, says: str) -> None:
    found = compared(f"m 1 1 1 A {outcome}", reason=[REASONS.index(reason)], landing=[[0.0, y]])
    assert found == ([(2, says)] if says else [], [])


@pytest.mark.parametrize(
    ("inside", "outside", "says"),
    [(1, 1, False), (2, 1, False), (1, 2, True), (4, 2, False), (3, 2, True), (0, 3, True), (0, 2, False)],
)
def test_returned_strokes_are_met_in_court(inside: int, outside: int, says: bool) -> None:
    n = inside + outside
    rows = [f"m 1 1 {i + 1} {'AB'[i % 2]} r" for i in range(n)]
    found = compared(*rows, landing=[[0.0, 5.0]] * inside + [[3.5, 5.0]] * outside)[0]
    assert [text.startswith("a third of the returned strokes") for _, text in found] == [True] * says
    assert all(line is None for line, _ in found)


def test_heights_that_are_unusual_for_a_shot_type_are_told() -> None:
    shots = ["drop", "smash", "half-smash", "lift", "net-shot", "drive"]
    rows = [f"m 1 1 {i + 2} {'AB'[i % 2]} r" for i in range(6)]
    shot = [SHOTS.index(name) for name in shots]
    assert compared(*rows, shot=shot, height=[1, 1, 1, 0, 0, 1])[0] == []
    below, above = compared(*rows, shot=shot, height=[0, 0, 0, 0, 0, 0])[0], compared(*rows, shot=shot, height=[1] * 6)[0]
    assert below == [(i + 2, f"a {name} struck below the net") for i, name in enumerate(shots[:3])]
    assert above == [(i + 5, f"a {name} struck above the net") for i, name in enumerate(shots[3:5])]


def test_problems_say_where_they_are() -> None:
    assert str(Problem(Path("a.csv"), "wrong")) == "a.csv: wrong"
    assert str(Problem(Path("a.csv"), "wrong", 3)) == "a.csv, line 3: wrong"
    assert str(Problem(Path("a.json"), "wrong", 3, "stroke")) == "a.json, stroke 3: wrong"


def test_a_reading_counts_what_contradicts_and_what_agrees() -> None:
    fresh, zero = np.array([True, False, False]), np.zeros(3, np.int64)
    scores = [(1, 0), (1, 1), (3, 1)]
    # The last change is impossible, the second winner is not the one told, the first is.
    found = inference._read(scores, fresh, np.array([0, 0, -1]), zero, before=False)
    assert (*found[:3], found[3].tolist()) == (2, -1, scores, [0, 1, -1])
    found = inference._read(scores, fresh, np.array([1, 0, 1]), 1 - zero, before=False)
    assert (*found[:3], found[3].tolist()) == (1, -2, [(0, 1), (1, 1), (1, 3)], [1, 0, -1])
    # Scores before the rallies start at 0:0; the reported winner decides the last rally.
    found = inference._read(scores[:2], fresh[:2], np.array([-1, 0]), zero[:2], before=True)
    assert (*found[:3], found[3].tolist()) == (1, 0, [(1, 1), (2, 1)], [1, -1])
    for start in ((0, 1), (1, 0)):
        assert inference._read([start], fresh[:1], np.array([-1]), zero[:1], before=True)[0] == 1
    assert inference._read([(0, 0)], fresh[:1], np.array([1]), zero[:1], before=True)[:3] == (0, 0, [(0, 1)])
    assert inference._read([None], fresh[:1], np.array([1]), zero[:1], before=True)[:3] == (0, 0, [None])
