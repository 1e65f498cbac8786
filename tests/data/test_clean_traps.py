"""Every defect of the published data, made on purpose, and what cleaning makes of it."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.data import clean_matches
from shuttle_marl.data.schema import OUTCOMES, REASONS, Cleaned, Outcome, violations
from shuttle_marl.data.shuttleset import AREA_OF_LABEL, NEAREST_OF_LABEL
from shuttle_marl.game import court
from shuttle_marl.game.stroke import SHOTS
from tests.data.upstream_layout import (
    CLEAR,
    DROP,
    LIFT,
    SERVE,
    SHUTTLESET,
    SHUTTLESET22,
    SMASH,
    Hit,
    Layout,
    Row,
    game,
    pixel,
    plain_game,
    rally,
)

NAME = "Viktor_AXELSEN _CHEN_Long_Malaysia_Masters_2020_ Finals"


def cleaned(root: Path, *games: list[dict[str, str]], **options: Any) -> Cleaned:
    Layout(root).match(NAME, games, **options)
    result = clean_matches(root)
    assert [str(v) for v in violations(result.strokes)] == []
    assert result.account.strokes == result.account.strokes_kept + sum(result.account.dropped.values())
    return result


def column(result: Cleaned, name: str) -> list:
    return result.strokes[name].to_pylist()


def test_a_sound_game_is_kept_whole(tmp_path: Path) -> None:
    result = cleaned(tmp_path, plain_game(4))
    assert result.account.as_json() == {
        "matches": 1,
        "rallies": {"total": 4, "kept": 4},
        "strokes": {"total": 13, "kept": 13},
        "dropped": {},
        "area_agreement": 1.0,
    }
    first = result.strokes.slice(0, 3).to_pylist()
    assert [row["player"] for row in first] == ["viktor-axelsen", "chen-long", "viktor-axelsen"]
    assert [SHOTS[row["shot"]] for row in first] == ["short-serve", "lift", "smash"]
    assert [row["height"] for row in first] == [0, 0, 1]
    assert [OUTCOMES[row["outcome"]] for row in first] == ["returned", "returned", "winner"]
    assert [court.AREAS[row["area"]] for row in first] == ["front-centre", "back-left", "middle-left"]
    assert (first[1]["landing_x"], first[1]["landing_y"]) == pytest.approx((LIFT.x, LIFT.y), abs=1e-3)
    assert (first[1]["striker_x"], first[1]["striker_y"]) == pytest.approx((0.2, -4.0), abs=1e-3)
    assert (first[1]["receiver_x"], first[1]["receiver_y"]) == pytest.approx((0.1, 3.8), abs=1e-3)
    assert first[0]["contact_x"] is None
    assert (first[1]["contact_x"], first[1]["contact_y"]) == pytest.approx((-SERVE.x, -SERVE.y), abs=1e-3)
    assert [(row["points"], row["points_opponent"]) for row in first] == [(1, 0), (0, 1), (1, 0)]


def test_ends_swap_between_and_within_games(tmp_path: Path) -> None:
    late = [
        rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="對手落地致勝", a_below=False),
        rally(2, "A", [SERVE, LIFT, SMASH], (2, 0), reason="對手落地致勝", a_below=True),
    ]
    result = cleaned(tmp_path, plain_game(4, a_below=True), plain_game(4, a_below=False), game(late))
    games = [result.strokes.filter(np.equal(column(result, "game"), i)) for i in (1, 2, 3)]
    for name in ("landing_x", "landing_y", "striker_y", "receiver_y", "area"):
        np.testing.assert_allclose(games[0][name].to_numpy(), games[1][name].to_numpy(), atol=1e-3)
        np.testing.assert_allclose(games[2][name].to_numpy()[:3], games[2][name].to_numpy()[3:], atol=1e-3)
    assert result.account.area_agreement == 1


@pytest.mark.parametrize(("number", "source", "mirror"), [
    (9, SHUTTLESET, True), (20, SHUTTLESET, True), (8, SHUTTLESET, False), (21, SHUTTLESET, False),
    (12, SHUTTLESET22, False),
])  # fmt: skip
def test_mirrored_labels(tmp_path: Path, number: int, source: str, mirror: bool) -> None:
    games = [plain_game(4, a_below=below, mirror_below=mirror) for below in (True, False)]
    result = cleaned(tmp_path, *games, number=number, source=source)
    assert result.account.area_agreement == 1


def test_labels_decide_nothing(tmp_path: Path) -> None:
    result = cleaned(tmp_path, plain_game(4, mirror_below=True), number=3)
    assert result.account.area_agreement < 1
    sound = clean_matches(Layout(tmp_path / "sound").match(NAME, [plain_game(4)]).parents[2])
    assert column(result, "area") == column(sound, "area")


def test_a_match_in_both_sets_counts_once(tmp_path: Path) -> None:
    layout = Layout(tmp_path)
    layout.match(NAME, [plain_game(4)], source=SHUTTLESET, players=("Viktor AXELSEN", "CHEN Long"))
    layout.match(NAME, [plain_game(4)], source=SHUTTLESET22, number=7, players=("VIKTOR Axelsen", "Chen Long"))
    layout.match("Other", [plain_game(2)], source=SHUTTLESET22, number=8)
    result = clean_matches(tmp_path)
    assert result.account.matches == 2
    assert result.account.strokes == 13 + 6
    assert set(column(result, "source")) == {"ShuttleSet", "ShuttleSet22"}
    assert set(column(result, "player")) == {"viktor-axelsen", "chen-long"}


def test_unknown_serve_leaves_the_rest_of_its_rally(tmp_path: Path) -> None:
    rows = rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="對手落地致勝")
    rows[0] |= {"type": "未知球種", "flaw": "1"}
    for name in ("landing_x", "landing_y", "landing_area", "player_location_x", "player_location_y"):
        rows[0][name] = ""
    rows[1]["hit_x"] = rows[1]["hit_y"] = ""
    result = cleaned(tmp_path, rows)
    assert result.account.dropped == {"unknown shot type": 1}
    assert column(result, "stroke") == [2, 3]
    assert column(result, "contact_x") == [None, pytest.approx(-LIFT.x, abs=1e-3)]
    assert column(result, "outcome") == [Outcome.RETURNED, Outcome.WINNER]


def test_missing_winner_follows_from_the_score(tmp_path: Path) -> None:
    rows = game([
        rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="", winner=""),
        rally(2, "A", [SERVE, LIFT, SMASH, CLEAR], (2, 0), reason="", winner=""),
        rally(4, "A", [SERVE, LIFT], (4, 0), reason="", winner=""),  # rally 3 was not annotated: two points at once
        rally(5, "A", [SERVE, LIFT], (4, 1), reason="", winner=""),
    ])  # fmt: skip
    result = cleaned(tmp_path, rows)
    ends = [row["outcome"] for row in result.strokes.to_pylist() if row["outcome"] != Outcome.RETURNED]
    assert ends == [Outcome.WINNER, Outcome.FAULT, Outcome.UNKNOWN, Outcome.WINNER]
    assert {REASONS[r] for r in column(result, "reason")} == {"returned", "unknown"}


@pytest.mark.parametrize(("chinese", "score", "winner", "reason", "outcome"), [
    ("出界", (0, 1), None, "out", Outcome.FAULT), ("掛網", (0, 1), None, "net", Outcome.FAULT),
    ("未過網", (0, 1), None, "short", Outcome.FAULT), ("犯規", (0, 1), None, "foul", Outcome.FAULT),
    ("對手落地致勝", (1, 0), None, "landed", Outcome.WINNER), ("落點判斷失誤", (1, 0), None, "misjudged", Outcome.WINNER),
    ("對手落地判斷失誤", (1, 0), None, "misjudged", Outcome.WINNER),
    ("掛網", (0, 1), "A", "net", Outcome.FAULT),  # the score outweighs the annotated winner
    ("掛網", (1, 0), "A", "unknown", Outcome.UNKNOWN),  # who hit the net cannot win: a stroke is missing
])  # fmt: skip
def test_reasons(tmp_path: Path, chinese: str, score: tuple[int, int], winner: str | None, reason: str, outcome: int) -> None:
    result = cleaned(tmp_path, rally(1, "A", [SERVE, LIFT, SMASH], score, reason=chinese, winner=winner))
    assert result.strokes.to_pylist()[-1]["reason"] == REASONS.index(reason)
    assert result.strokes.to_pylist()[-1]["outcome"] == outcome


def test_broken_homography_drops_the_game_alone(tmp_path: Path) -> None:
    squeezed = plain_game(4)
    for row in squeezed:
        row["player_location_y"] = row["opponent_location_y"]
    squeezed[0]["landing_x"] = "90000"
    result = cleaned(tmp_path, plain_game(4), squeezed)
    assert result.account.dropped == {"broken homography": 13}
    assert set(column(result, "game")) == {1}


def test_rallies_out_of_order_are_put_in_order(tmp_path: Path) -> None:
    rows = game([
        rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="", winner=""),
        rally(3, "A", [SERVE, LIFT, SMASH], (3, 0), reason="", winner=""),
        rally(2, "A", [SERVE, LIFT, SMASH], (2, 0), reason="", winner=""),
    ])  # fmt: skip
    result = cleaned(tmp_path, rows)
    assert column(result, "rally") == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert column(result, "outcome")[2::3] == [Outcome.WINNER] * 3


def test_a_rally_number_given_twice_keeps_the_first(tmp_path: Path) -> None:
    rows = game([
        rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="對手落地致勝"),
        rally(1, "A", [SERVE, LIFT], (2, 0), reason="出界", frame=9000),
    ])  # fmt: skip
    result = cleaned(tmp_path, rows)
    assert result.account.dropped == {"broken rally": 2}
    assert column(result, "outcome") == [Outcome.RETURNED, Outcome.RETURNED, Outcome.WINNER]


@pytest.mark.parametrize("defect", ["gap", "same player", "starts late"])
def test_broken_rallies_are_dropped(tmp_path: Path, defect: str) -> None:
    bad = rally(2, "A", [SERVE, LIFT, CLEAR, SMASH], (1, 1), reason="對手落地致勝")
    if defect == "gap":
        bad.pop(1)
    elif defect == "same player":
        bad[2]["player"] = "B"
    else:
        bad.pop(0)
    result = cleaned(tmp_path, [*rally(1, "A", [SERVE, LIFT, SMASH], (1, 0), reason="對手落地致勝"), *bad])
    assert result.account.dropped == {"broken rally": len(bad)}
    assert result.account.rallies == 2
    assert result.account.rallies_kept == 1


def test_contact_heights_of_a_game_that_contradicts_itself(tmp_path: Path) -> None:
    rows = plain_game(8)
    for i, row in enumerate(rows[:-1]):
        row["landing_height"] = rows[i + 1]["hit_height"] if rows[i + 1]["ball_round"] != "1" else ""
    for row in rows[1::2]:
        row["hit_height"] = "2.0" if row["hit_height"] == "1.0" else "1.0"
    assert cleaned(tmp_path, rows).account.dropped == {"contact heights unreliable": len(rows)}


@pytest.mark.parametrize(("wrong", "dropped"), [(1, False), (3, True)])
def test_contact_heights_that_contradict_the_shot_types(tmp_path: Path, wrong: int, dropped: bool) -> None:
    """One smash from below the net is an oddity; three in a short game mean that the heights are noise."""
    rows = plain_game(8)
    smashes = [row for row in rows if row["type"] == "殺球"]
    assert len(smashes) >= wrong
    for row in smashes[:wrong]:
        row["hit_height"] = "2"
    assert bool(cleaned(tmp_path, rows).account.dropped) == dropped


def test_rows_that_cannot_be_used(tmp_path: Path) -> None:
    rows = game(rally(i, "A", [SERVE, LIFT, CLEAR, SMASH, DROP], (0, i), reason="掛網", winner="B") for i in range(1, 7))
    by_rally = {i: rows[5 * i - 5 : 5 * i] for i in range(1, 7)}
    by_rally[1][1]["hit_height"] = ""
    by_rally[2][0]["type"] = "挑球"
    by_rally[3][2]["type"] = "發長球"
    by_rally[4][1]["landing_x"] = by_rally[4][1]["landing_y"] = ""
    # A fault may lack its landing.
    by_rally[5][4]["landing_x"] = by_rally[5][4]["landing_y"] = ""
    # Everything about this stroke is on the wrong side.
    wrong = by_rally[6][2]
    for a, b in (("player_location", "opponent_location"),):
        for axis in "xy":
            wrong[f"{a}_{axis}"], wrong[f"{b}_{axis}"] = wrong[f"{b}_{axis}"], wrong[f"{a}_{axis}"]
    wrong["hit_x"], wrong["hit_y"], wrong["landing_x"], wrong["landing_y"] = (
        wrong["landing_x"], wrong["landing_y"], wrong["hit_x"], wrong["hit_y"],
    )  # fmt: skip
    result = cleaned(tmp_path, rows)
    assert result.account.dropped == {
        "serve type inside a rally": 1,
        "first stroke is no serve": 1,
        "contact height missing": 1,
        "side of the court unknown": 1,
        "landing missing": 1,
    }
    assert column(result, "area").count(None) == 1


def test_exchanged_letters_are_put_right(tmp_path: Path) -> None:
    """No one changes ends within game 1: in the odd rally A and B are each other."""
    rows = plain_game(6)
    odd = rally(7, "A", [SERVE, LIFT, SMASH], (3, 4), reason="掛網", winner="B", a_below=True)
    for row in odd:
        row["player"] = "B" if row["player"] == "A" else "A"
    result = cleaned(tmp_path, [*rows, *odd])
    assert column(result, "player")[-3:] == ["viktor-axelsen", "chen-long", "viktor-axelsen"]
    assert column(result, "outcome")[-3:] == [Outcome.RETURNED, Outcome.RETURNED, Outcome.FAULT]


def test_labels_name_every_area_once_and_lead_around_the_court() -> None:
    """Of the labels inside, test_public_matches compares most with the coordinates."""
    assert sorted(AREA_OF_LABEL) == list(range(9))
    around = [divmod(area, 3) for area in NEAREST_OF_LABEL]
    assert 4 not in NEAREST_OF_LABEL
    assert len(set(around)) == len(around)
    steps = [abs(a[0] - b[0]) + abs(a[1] - b[1]) for a, b in itertools.pairwise(around)]
    assert steps == [1] * 6
    # Nothing goes out between the players: the front is open at the net.
    assert around[0][0] == around[-1][0] == 0


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
    players = strokes.filter(np.equal(strokes["game"], games))["player"].to_pylist()
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
    result = cleaned(tmp_path, rows)
    assert column(result, "technique") == [0, 1, 2, 1]
    assert column(result, "height") == [0, 0, 1, 1], "serves are struck below the net"
