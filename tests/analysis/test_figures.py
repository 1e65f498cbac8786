"""Figures of reports, each counted again in a plain way: options, habits, endings, rallies, values, places and forms."""

import datetime
import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from scipy import special, stats

from shuttle_marl.analysis import match as report
from shuttle_marl.analysis.brief import Option, _chosen, brief, expected_of, is_short, options, won_or_lost
from shuttle_marl.analysis.course import RallyRow, score_of
from shuttle_marl.analysis.decisions import Places, Rating, rated, theme_of, usual_of
from shuttle_marl.analysis.habits import Habit, discoveries, endings, habits, interval, with_discoveries
from shuttle_marl.analysis.scouting import Realised, _as_known, plain, realised, season
from shuttle_marl.analysis.summary import AnalysisError, rally_table, summarise
from shuttle_marl.analysis.worth import NORMAL, agree, calibrated, error_of
from shuttle_marl.data.schema import REASONS, STROKES, stroke_table
from shuttle_marl.dynamics.habits import NONE, QUESTIONS, Plays, Tally, questions, tally
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.recovery import CENTRE
from shuttle_marl.game.scoring import BWF
from shuttle_marl.game.shipped import RELIABLE, Estimate
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES

SERVE, LIFT, CLEAR, DROP, SMASH = (SHOTS.index(name) for name in ("short-serve", "lift", "clear", "drop", "smash"))


def plays_of(n: int, **columns: Any) -> Plays:
    """Lifts answered by lifts, of which nothing else is known, with some other columns."""
    usual: dict[str, Any] = {
        **{name: np.full(n, LIFT) for name in ("own", "incoming", "shot")},
        **{name: np.full(n, -1) for name in ("met", "area")},
        **{name: np.zeros(n, np.int64) for name in ("contact", "technique", "group")},
        **{name: np.zeros(n) for name in ("fault", "winner")},
        "opposite": np.zeros(n, np.bool_),
        "weight": np.ones(n),
    }
    return Plays(**{**usual, **columns})


def some_plays(n: int, seed: int, smashes: float = 0.3) -> tuple[Plays, np.ndarray[Any, Any]]:
    """Strokes of a few kinds, and whether their rallies were won; more with some kinds, and 500 smashes; some not known."""
    rng = np.random.default_rng(seed)
    shot = rng.choice([SERVE, CLEAR, LIFT, SMASH], n, p=[0.1, 0.3, 0.6 - smashes, smashes])
    area = np.where(rng.random(n) < 0.2, -1, rng.choice([0, 6, 8], n))
    chance = 0.3 + 0.35 * ((shot == SMASH) & (np.arange(n) < 500)) + 0.2 * (area == 8)
    won = np.where(rng.random(n) < 0.05, np.nan, rng.random(n) < chance)
    end = rng.random(n)
    found = plays_of(
        n, shot=shot, area=area, technique=rng.integers(0, 4, n),
        incoming=np.where(shot == SERVE, NONE, rng.choice([SERVE, DROP], n)),
        contact=rng.integers(0, 2, n), met=rng.integers(-1, 9, n), fault=(end < 0.3 + 0.3 * (shot == SMASH)) * 1.0,
        winner=(end > 0.9) * 1.0, own=rng.choice([SERVE, LIFT], n),
    )  # fmt: skip
    return found, won


@pytest.mark.parametrize("against", [False, True])
def test_options_are_those_that_a_plain_count_finds(against: bool) -> None:
    plays, won = some_plays(900, 1)
    mine = np.arange(900) < 500
    other = ~mine if against else None
    expected: dict[tuple[int, int], tuple[int, ...]] = {}
    known = np.isfinite(won) & (plays.shot >= 2)

    def counted(which: Any, shot: int, area: int) -> tuple[int, int]:
        rows = which & known & ((plays.shot == shot) | (shot < 0)) & ((plays.area == area) | (area < 0))
        return int(rows.sum()), int(won[rows].sum())

    for shot, area in itertools.product([-1, *range(len(SHOTS))], [-1, *range(9)]):
        own = counted(mine, shot, area)
        if against:
            rest = counted(~mine, shot, area)
        else:
            among = counted(mine & (plays.area >= 0) if area >= 0 else mine, -1, -1)
            rest = among[0] - own[0], among[1] - own[1]
        if (shot, area) != (-1, -1):
            expected[shot, area] = (*own, *rest)
    levels = [counted(which & (plays.area >= 0), -1, -1) for which in (mine, ~mine)]
    shift = special.logit(levels[0][1] / levels[0][0]) - special.logit(levels[1][1] / levels[1][0]) if against else 0.0
    z, usual = {}, {}
    for kind, (n, w, m, v) in expected.items():
        if min(n, m) < RELIABLE or not 0 < v < m:
            continue
        usual[kind] = special.expit(special.logit(v / m) + shift)
        pooled = (w + usual[kind] * m) / (n + m)
        score = (w / n - usual[kind]) / math.sqrt(pooled * (1 - pooled) * (1 / n + 1 / m))
        if score * (w / n - v / m) >= 0:
            z[kind] = score
    found = options(plays, won, mine, other)
    assert [(each.shot, each.area) for each in found] == sorted(z, key=lambda kind: -z[kind])
    assert len(found) > 5
    clear = dict(
        zip(z, stats.false_discovery_control([2 * stats.norm.sf(abs(score)) for score in z.values()]) <= 0.05, strict=True)
    )
    for each in found:
        kind = each.shot, each.area
        assert (each.strokes, each.won, each.others, each.others_won) == expected[kind]
        assert each.usual == pytest.approx(usual[kind])
        assert each.clear == clear[kind]
        assert each.gain == pytest.approx(each.won / each.strokes - each.others_won / each.others)
    assert {each.clear for each in found} == {False, True}


def option(shot: int, area: int, won: int = 5) -> Option:
    return Option(shot, area, 10, won, 20, 5, 0.25, False)


def test_chosen_options_say_different_things() -> None:
    ordered = [option(*kind) for kind in ((4, -1), (4, 3), (-1, 3), (5, 6), (-1, 6), (6, 6), (7, 7))]
    assert [each[:2] for each in _chosen(ordered, 3)] == [(4, -1), (-1, 3), (5, 6)]
    assert [each[:2] for each in _chosen(ordered, 2, [option(-1, 6), option(4, 5)])] == [(4, 3), (7, 7)]
    assert _chosen(ordered, 1) == (ordered[0],)
    assert _chosen(ordered, 0) == _chosen([], 3) == ()
    assert (option(4, 3).covers(4, 3), option(4, -1).covers(4, 3), option(-1, 3).covers(4, 3)) == (True, True, True)
    assert (option(4, 3).covers(4, 2), option(4, -1).covers(5, 3), option(-1, 3).covers(4, 2)) == (False, False, False)


def test_high_strokes_that_land_short_of_the_rear_are_short() -> None:
    shots, areas = np.array([CLEAR, CLEAR, LIFT, LIFT, SMASH, CLEAR]), np.array([5, 6, 2, 8, 0, -1])
    assert is_short(shots, areas).tolist() == [True, False, True, False, False, False]


def test_a_page_names_what_won_and_lost_and_how_the_opponent_answers() -> None:
    # The player strikes 60 clears of which 48 are won, and 60 smashes of which 12; 30 lifts after serves (20 won), 30 drops (5).
    shot = np.repeat([CLEAR, SMASH, LIFT, DROP], [60, 60, 30, 30])
    won = np.concatenate([np.arange(n) < w for n, w in ((60, 48), (60, 12), (30, 20), (30, 5))]).astype(float)
    incoming = np.where(np.arange(180) < 120, DROP, SERVE)
    answers = np.repeat([LIFT, DROP, CLEAR], [12, 8, 4])
    both = plays_of(
        204, shot=np.r_[shot, answers], incoming=np.r_[incoming, np.full(24, CLEAR)],
        contact=np.r_[np.zeros(180, int), np.ones(24, int)],
        area=np.r_[np.full(180, -1), np.repeat([8, 8, 2, -1], [6, 6, 6, 6])],
    )  # fmt: skip
    towards = np.arange(204) < 180
    own = tally(both.take(~towards))
    page = brief(own, None, both, np.r_[won, np.full(24, np.nan)], towards, ~towards)
    assert [(each.shot, each.area, each.strokes, each.won) for each in page.dos] == [(CLEAR, -1, 60, 48), (LIFT, -1, 30, 20)]
    assert [(each.shot, each.strokes, each.won, each.others, each.others_won) for each in page.donts] == [
        (SMASH, 60, 12, 120, 73), (DROP, 30, 5, 150, 80)
    ]  # fmt: skip
    assert page.returns is not None
    assert page.returns[:6] == (LIFT, -1, 30, 20, 30, 5)
    assert [each.expected.about for each in page.answers] == ["clear", "smash", "lift"], "the main strokes of the player"
    first = page.answers[0]
    assert (first.expected.kind, first.expected.strokes) == ("reply", 24)
    assert first.expected.most == (("lift", 0.5), ("drop", 8 / 24), ("clear", 4 / 24))
    assert first.areas == (0, 0, 6 / 18, 0, 0, 0, 0, 0, 12 / 18)
    assert page.answers[1].areas == (0,) * 9
    assert page.expected == ()
    few = tally(both.take(np.arange(204) >= 203))
    assert brief(own, few, None, np.zeros(0), towards, ~towards).answers[0].expected.about == "clear", (
        "without matches, by the tally"
    )
    assert brief(own, few, None, np.zeros(0), towards, ~towards).dos == ()


def test_expected_answers_are_the_three_most_frequent() -> None:
    own = tally(plays_of(20, incoming=np.full(20, DROP), contact=np.repeat([0, 1], 10),
                         shot=np.repeat([LIFT, CLEAR, DROP, SMASH, LIFT], [4, 3, 1, 4, 8])))  # fmt: skip
    found = expected_of(own, "reply", "drop")
    assert found.most == (("lift", 0.6), ("smash", 0.2), ("clear", 0.15))
    assert (found.kind, found.about, found.strokes) == ("reply", "drop", 20)
    below = expected_of(own, "reply", "drop", "below")
    assert below.most == (("lift", 0.4), ("clear", 0.3), ("smash", 0.2))
    none = expected_of(own, "serve")
    assert (none.most, none.strokes) == ((), 0)


@pytest.mark.parametrize("dispersed", [False, True])
def test_habits_are_shares_that_a_plain_count_finds(dispersed: bool) -> None:
    (mine, _), (others, _) = some_plays(400, 2, 0.5), some_plays(700, 3)
    mine = plays_of(400, **{name: getattr(mine, name) for name in vars(mine)} | {"group": np.arange(400) // 40})
    counts = [tally(mine), tally(others)]
    expected: dict[tuple[str, tuple[str, ...], str], tuple[float, ...]] = {}
    for number, ((question, one), (_, two)) in enumerate(zip(questions(mine), questions(others), strict=True)):
        n, m = int((one >= 0).sum()), int((two >= 0).sum())
        scale = max(float(each.dispersion[number]) for each in counts) if dispersed else 1.0
        for k, name in enumerate(question.answers):
            a, b = int((one == k).sum()), int((two == k).sum())
            if min(n, m) < RELIABLE or max(a, b / m * n) < 1 or (question.kind == "serve" and k):
                continue
            pooled = (a + b) / (n + m)
            error = math.sqrt(scale * pooled * (1 - pooled) * (1 / n + 1 / m))
            p = 2 * stats.norm.sf(abs(a / n - b / m) / error) if error else 1.0
            low, high = stats.binomtest(a, n).proportion_ci(0.9, method="wilson") if scale == 1 else interval(a / n, n / scale)
            expected[question.kind, question.about, name] = n, a / n, low, high, b / m, p
    found = habits(*counts, dispersed=dispersed)
    assert {(each.kind, each.about, each.answer) for each in found} == expected.keys()
    clear = dict(zip(expected, discoveries([values[-1] for values in expected.values()]), strict=True))
    for each in found:
        key = each.kind, each.about, each.answer
        values = (each.strokes, each.share, each.low, each.high, each.usual, each.p)
        assert values == pytest.approx(expected[key], abs=1e-6)
        assert each.clear == (clear[key] and abs(each.share - each.usual) >= 0.03)
    order = [(not each.clear, -abs(each.share - each.usual) * math.sqrt(each.strokes)) for each in found]
    assert order == sorted(order)
    assert any(each.clear for each in found)
    assert any(each.low == 0 or each.high == 1 for each in found) or all(0 < each.low < each.high < 1 for each in found)


def test_answers_that_hardly_anybody_gives_are_no_habits() -> None:
    def answers(clears: int, n: int) -> Tally:
        return tally(plays_of(n, shot=np.where(np.arange(n) < clears, CLEAR, LIFT), incoming=np.full(n, DROP)))

    for mine, others, told in (
        ((1, 100), (0, 100), True), ((0, 100), (1, 100), True), ((0, 100), (1, 101), False), ((1, 20), (0, 20), True),
        ((0, 19), (9, 20), False), ((1, 20), (0, 19), False),
    ):  # fmt: skip
        found = habits(answers(*mine), answers(*others))
        assert (("reply", ("drop", "below"), "clear") in {(each.kind, each.about, each.answer) for each in found}) == told
    serves = tally(plays_of(30, shot=np.arange(30) % 2, incoming=np.full(30, NONE), own=np.full(30, NONE)))
    assert [each.answer for each in habits(serves, serves) if each.kind == "serve"] == ["short-serve"], "the other serve follows"


def test_small_differences_are_no_habits() -> None:
    def habit(share: float, p: float) -> Habit:
        return Habit(kind="", about=(), answer="", strokes=9, share=share, low=0, high=1, usual=0.5, p=p)

    found = with_discoveries([habit(0.53125, 0.01), habit(0.46875, 0.01), habit(0.52, 0.01), habit(0.9, 0.2)])
    assert [each.clear for each in found] == [True, True, False, False]
    assert with_discoveries([]) == []
    assert discoveries([]).shape == (0,)
    assert discoveries([0.01, 0.04, 0.2]).tolist() == [True, False, False]
    assert discoveries([0.05]).tolist() == [True]


@pytest.mark.parametrize(("won", "n"), [(0, 20), (20, 20), (7, 20), (150, 300)])
def test_intervals_are_those_of_wilson(won: int, n: int) -> None:
    expected = stats.binomtest(won, n).proportion_ci(0.9, method="wilson")
    assert interval(won / n, n) == pytest.approx((expected.low, expected.high), abs=1e-6)
    wide = stats.binomtest(won, n).proportion_ci(0.95, method="wilson")
    assert interval(won / n, n, 1.959964) == pytest.approx((wide.low, wide.high), abs=1e-6)


def test_endings_are_those_that_a_plain_count_finds() -> None:
    (mine, _), (others, _) = some_plays(500, 4), some_plays(900, 5)
    mine.fault[mine.shot == CLEAR] = 1.0
    kinds = [(shot, None) for shot in SHOTS] + [(shot, technique) for shot in SHOTS for technique in TECHNIQUES]
    expected = {}
    for shot, technique in kinds:
        rows = [each.shot == SHOTS.index(shot) for each in (mine, others)]
        if technique is not None:
            rows = [row & (each.technique == TECHNIQUES.index(technique)) for row, each in zip(rows, (mine, others), strict=True)]
        n, m = (int(each.sum()) for each in rows)
        if min(n, m) >= RELIABLE:
            expected[shot, technique] = [(n, m, each.fault[row].sum(), each.winner[row].sum()) for each, row in
                                         zip((mine, others), rows, strict=True)]  # fmt: skip
    found = endings(tally(mine), tally(others))
    assert [(each.shot, each.technique) for each in found] == list(expected)
    tests = []
    for each in found:
        (n, m, faults, winners), (_, _, usual_faults, usual_winners) = expected[each.shot, each.technique]
        assert each.strokes == n
        for part, a, b in ((each.fault, faults, usual_faults), (each.winner, winners, usual_winners)):
            assert part == pytest.approx((a / n, *interval(a / n, n), b / m))
            pooled = (a + b) / (n + m)
            tests.append(2 * stats.norm.sf(abs(a / n - b / m) / math.sqrt(pooled * (1 - pooled) * (1 / n + 1 / m))))
    assert [mark for each in found for mark in each.clear] == discoveries(tests).tolist()
    assert {mark for each in found for mark in each.clear} == {False, True}
    assert endings(tally(mine.take(np.arange(500) < 19)), tally(others)) == []
    same = tally(plays_of(30))
    assert [each.clear for each in endings(same, same)] == [(False, False)] * 2, "no ending at all"


# Rallies.


def strokes_of(*rallies: str, game: str = "", match: str = "", **columns: Any) -> pa.Table:
    """Rallies, each as letters of who strikes (A or B), and the last one's outcome: w, f or u; of shot types by number."""
    rows: list[dict[str, Any]] = []
    for number, text in enumerate(rallies):
        who, end = text[:-1], text[-1]
        for k, player in enumerate(who):
            last = k == len(who) - 1
            rows.append({
                "match": match[number] if match else "m", "source": "s", "discipline": "MS",
                "game": int(game[number]) if game else 1,
                "rally": number + 1, "stroke": k + 1, "player": player, "opponent": "AB"[player == "A"],
                "shot": SERVE if not k else LIFT,
                "height": 0, "technique": 0, "outcome": "rfwu".index(end) if last else 0,
                "reason": 0 if not last else REASONS.index({"w": "landed", "f": "out"}.get(end, "unknown")),
            })  # fmt: skip
    names = {name for row in rows for name in row} | columns.keys()
    table = {name: pa.array(columns.get(name, [row.get(name) for row in rows]), STROKES.field(name).type) for name in names}
    return stroke_table(table, {})


def test_rallies_of_strokes() -> None:
    strokes = strokes_of("ABw", "BABf", "Au", "Bw", game="1122", clock=[3, 5, 10, 11, None, 20, 30])
    assert rally_table(strokes).drop_columns(["match", "discipline"]).to_pydict() == {
        "game": [1, 1, 2, 2], "rally": [1, 2, 3, 4], "first": [0, 2, 5, 6], "length": [2, 3, 1, 1],
        "server": ["A", "B", "A", "B"],
        "receiver": ["B", "A", "B", "A"], "winner": ["B", "A", None, "B"], "ending": ["winner", "out", "not known", "winner"],
        "last_shot": [LIFT, LIFT, SERVE, SERVE], "seconds": [2, None, 0, 0],
    }  # fmt: skip
    np.testing.assert_array_equal(won_or_lost(strokes), [0, 1, 0, 1, 0, np.nan, 1])
    late = rally_table(strokes.slice(3))  # the serve is not there
    assert (late["server"][0].as_py(), late["receiver"][0].as_py(), late["length"][0].as_py()) == ("B", "A", 3)


def test_summaries_count_strokes_rallies_and_times() -> None:
    strokes = strokes_of("ABw", "BABf", "Au", "Bw", clock=[3, 5, 10, 11, 14, 20, 30])
    both, one = summarise(strokes), summarise(strokes, "A")
    assert (both.strokes, both.rallies, both.matches, one.strokes, one.rallies) == (7, 4, 1, 3, 4)
    assert (both.length, both.seconds, one.seconds) == (7 / 4, (2 + 1 + 3) / 3, 1)
    assert (both.wins, one.wins, summarise(strokes, "B").wins) == (1 / 3, 1 / 3, 2 / 3)
    assert both.shots[[SERVE, LIFT]].tolist() == pytest.approx([4 / 7, 3 / 7])
    assert both.endings.tolist() == pytest.approx([2 / 3, 1 / 3, 0, 0, 0, 0])
    assert both.lengths[:4].tolist() == [0, 2, 1, 1]
    assert np.argwhere(both.transitions).tolist() == [[SERVE, LIFT], [LIFT, LIFT]]
    assert both.transitions[SERVE, LIFT] == 2
    assert one.transitions.sum() == 1
    assert math.isnan(both.value)
    landed: dict[str, Any] = {"landing_x": [1.0, 1.0, 2.0, None, 0.5, 1.0, 3.0],
              "landing_y": [2.0, 5.0, 7.0, None, 4.0, 6.0, 9.0],
              "area": [0, 8, 6, None, 4, 7, 7], "in_court": [True, True, False, None, True, True, False]}  # fmt: skip
    seen = summarise(strokes_of("ABw", "BABf", "Au", "Bw", hand=[0, 1, 1, 0, 1, 0, 1], **landed))
    assert seen.points.tolist() == [[-1, 2], [1, 5], [-1, 6]], "good strokes in court, seen by a left-handed B in the mirror"
    assert np.flatnonzero(seen.areas).tolist() == [2, 7, 8]
    assert (seen.areas.sum(), seen.marked) == (pytest.approx(1), True)
    assert summarise(strokes_of("Aw")).shots[SERVE] == 1
    with pytest.raises(AnalysisError, match="no strokes of C; players are A, B"):
        summarise(strokes, "C")


def rally(swing: float = 0.0, *, game: int = 1, number: int = 1, winner: int | None = 0, strokes: int = 5, server: int = 0,
          points: tuple[int, int] = (0, 0)) -> RallyRow:  # fmt: skip
    return RallyRow(
        key=(game, number), points=points, games=(0, 0), server=server, winner=winner, strokes=strokes, ending="out",
        last_shot="lift",
        last_area=-1, given=None, before=0.5, after=0.5 + swing, decided=None, seconds=None,
    )  # fmt: skip


def test_key_moments_are_large_and_of_several_games() -> None:
    swings = [(0.5, 1), (0.375, 1), (0.3, 1), (-0.4, 2), (0.25, 3), (0.24, 3), (0.9, 3)]
    rallies = [rally(swing, game=game, winner=None if swing == 0.9 else 0) for swing, game in swings]
    assert report._moments(rallies) == [0, 3, 1, 4], "of the first game two, of the third those of half the largest swing"
    assert report._moments([]) == []
    many = [rally(0.25, game=game) for game in (1, 1, 2, 2, 3, 3)]
    assert report._moments(many) == [0, 1, 2, 3, 4]


def test_rallies_won_by_length_and_as_server() -> None:
    lengths = [1, 3, 4, 7, 8, 12, 13, 99, 5, 5]
    rallies = [rally(strokes=n, winner=None if i == 9 else int(i == 4), server=i % 2) for i, n in enumerate(lengths)]
    found = report._lengths([*rallies, *[rally(strokes=9)] * 20])
    assert [(each.label, each.player, each.rallies, each.won) for each in found] == [
        ("1\N{EN DASH}3", 0, 2, 2), ("4\N{EN DASH}7", 0, 3, 3), ("8\N{EN DASH}12", 0, 22, 21), ("13+", 0, 2, 2)
    ]  # fmt: skip
    assert [each.clear for each in found] == [False, False, True, False]
    assert (found[0].low, found[0].high) == pytest.approx(interval(1.0, 2))
    assert report._lengths([rally(winner=None)]) == []
    strokes = strokes_of("Aw", "Bw", "Aw", "ABw", "Aw", "Bw")
    plays = plays_of(7, shot=np.array([0, 1, 1, 0, LIFT, 0, 0]))
    rallies = [rally(winner=w, server=s) for s, w in ((0, 0), (1, 0), (0, 1), (0, 0), (0, None), (1, 1))]
    told = report._serving(rallies, plays, strokes)
    assert [(each.player, each.label, each.rallies, each.won) for each in told] == [
        (0, "serving", 3, 2), (0, "short-serve", 2, 2), (0, "long-serve", 1, 0), (0, "receiving", 2, 1),
        (1, "serving", 2, 1), (1, "short-serve", 1, 1), (1, "long-serve", 1, 0), (1, "receiving", 3, 1),
    ]  # fmt: skip


def test_values_of_shot_types_with_intervals_over_rallies() -> None:
    added = np.tile([0.25, 0.5, np.nan], 20)
    strokes = strokes_of(*["ABAw"] * 20, shot=[SERVE, LIFT, CLEAR] * 20).append_column("value_added", pa.array(added))
    seat = np.tile([0, 1, 0], 20)
    found = report._values(strokes, seat)
    assert [(each.player, each.shot, each.strokes, each.points.value) for each in found] == [
        (0, "short-serve", 20, 5.0), (1, "lift", 20, 10.0)
    ]  # fmt: skip
    for each, one in zip(found, (0.25, 0.5), strict=True):
        error = NORMAL * math.sqrt(20 * one**2 + 0.25)
        assert (each.points.low, each.points.high) == pytest.approx((each.points.value - error, each.points.value + error))
        assert each.clear
    assert report._values(strokes.slice(3), seat[3:]) == []
    at = strokes.column_names.index("value_added")
    balanced = strokes.set_column(at, "value_added", pa.array(np.tile([1.0, np.nan, np.nan, -1.0, np.nan, np.nan], 10)))
    [none] = report._values(balanced, seat)
    assert (none.points.value, none.clear) == (0, False)


def test_forced_faults_are_counted_where_they_are_known() -> None:
    strokes = strokes_of("Af", "Bf", "Af", "Af", "Aw", forced=[True, False, False, True, None])
    mine = np.array([True, False, True, True, True])
    assert report._faults(strokes, mine) == (2, 1)
    assert report._faults(strokes, ~mine) == (0, 1)


def test_the_end_of_a_game_that_the_data_lack() -> None:
    first = [rally(points=(20, 10), winner=None), rally(game=2, points=(0, 0), winner=1, server=0)]
    assert score_of(first, BWF) == (((21, 10), (0, 1)), (1,)), "the leader served first in the next game"
    assert score_of([first[0], rally(game=2, winner=1, server=1)], BWF) == (((20, 10), (0, 1)), ())
    assert score_of([first[0], rally(game=2, number=2, winner=1, server=1)], BWF) == (((21, 10), (0, 1)), (1,)), (
        "the first server is unknown"
    )
    assert score_of([rally(points=(20, 10), winner=1)], BWF) == (((21, 11),), (1,))
    assert score_of([rally(points=(10, 20), winner=1)], BWF) == (((10, 21),), ())
    assert score_of([rally(points=(20, 20), winner=None)], BWF) == (((20, 20),), ())
    assert score_of([rally(points=(29, 29), winner=None)], BWF)[1] == (1,)


# Decisions.


def test_themes_and_usual_answers() -> None:
    stroke = [0, 1, 2, 3, 4]
    catalogue = SimpleNamespace(shot=np.array([SERVE, LIFT, SMASH, CLEAR, LIFT]))
    played: Any = SimpleNamespace(catalogue=catalogue, stroke=stroke)
    assert [theme_of(played, number, above=True) for number in range(5)] == ["serve", "return", "third", "defence", "attack"]
    assert theme_of(played, 4, above=False) == "net"
    assert (usual_of("drive"), usual_of("smash"), usual_of("clear")) == (0, 8, 9)


def test_places_lose_against_the_best_one() -> None:
    places = Places(position=np.array([1, CENTRE, 7]), people=np.array([0.5, 0.25, 0.25]), perfect=np.array([0, 1.0, 0]),
                    win=np.array([[0.5, 0.25, 0.75], [0.5, 0.5, 0.5]]), struck=np.array([0.5, 0.5]))  # fmt: skip
    assert places.loss.tolist() == [0.125, 0, 0.25]
    assert places.gain.tolist() == [[0, -0.25, 0.25], [0, 0, 0]]
    assert (places.question(1), places.question(7)) == (9, 9), "the centre is the usual answer"
    assert places.question(CENTRE) is places.question(3) is None, "no loss, and a place where few wait"
    other = Places(**{**vars(places), "position": np.array([CENTRE, 1, 7])})
    assert other.question(7) == 0
    one = Places(**{**vars(places), "win": np.array([[0.5, 0.25, 0.25], [0.5, 0.5, 0.5]])})
    assert one.question(1) is None, "only one place is wrong"


@pytest.mark.parametrize(
    ("fields", "fine"),
    [({"deviation": 0.0}, True), ({"deviation": 1000.0}, True), ({"deviation": 1000.1}, False), ({"deviation": -0.1}, False),
     ({"volatility": 1.0}, True), ({"volatility": 1.01}, False), ({"volatility": 0.0}, False), ({"points": math.inf}, False)],
)  # fmt: skip
def test_ratings_have_bounds(fields: dict[str, float], fine: bool) -> None:
    if fine:
        low, high = Rating(**fields).interval
        assert (low + high) / 2 == 1500
        assert high - low == pytest.approx(2 * 1.96 * fields.get("deviation", 350))
    else:
        with pytest.raises(Exception, match="expected finite points"):
            Rating(**fields)


def test_scores_are_between_lost_and_won() -> None:
    better, worse = rated(Rating(), [1, 1]), rated(Rating(), [0, 0])
    assert worse.points < 1500 < better.points
    assert better.deviation == worse.deviation or abs(better.deviation - worse.deviation) < 1
    for wrong in ([-0.1], [0.5, 1.1]):
        with pytest.raises(Exception, match="expected numbers from 0 to 1"):
            rated(Rating(), wrong)


def test_refits_that_agree_and_calibrated_figures() -> None:
    values = np.array([[0.1, 0.1, -0.1], [0.3, 0.1, 0.1], [0.2, 0.1, 0.1], [0.1, 0.1, 0.1], [0.3, 0.1, 0.1]])
    assert error_of(values) == pytest.approx(values.std(axis=0, ddof=1) * math.sqrt(1.2))
    assert agree(values).tolist() == [True, True, False]
    assert agree(values[:4]).tolist() == [False] * 3, "four refits are too few"
    assert np.isnan(error_of(values[:1])).all()
    assert calibrated(values[:, 1], None) == pytest.approx((0.1, 0.1, 0.1))
    found = calibrated(values[:, 1], Estimate(0.5, 0.3, 0.7))
    error = NORMAL * 0.1 * 0.4 / (2 * 1.959964)
    assert found == pytest.approx((0.05, 0.05 - error, 0.05 + error))


# Scouting.


def test_figures_as_json() -> None:
    day = datetime.date(2026, 1, 2)
    told = {"a": (1, 2.5, math.nan), 3: np.array([1, 2]), "day": day, "e": Estimate(1.0, 0.5, 2.0), "n": np.float64(2), "t": None}
    assert plain(told) == {
        "a": [1, 2.5, None], "3": [1, 2], "day": "2026-01-02", "e": {"value": 1.0, "low": 0.5, "high": 2.0}, "n": 2.0, "t": None,
    }  # fmt: skip
    assert plain(option(CLEAR, 0))["shot"] == "clear"
    assert plain(option(-1, 0)) | {"shot": 0} == {**option(-1, 0)._asdict(), "shot": 0, "area": AREAS[0]}
    assert (plain(option(-1, -1))["shot"], plain(option(0, -1))["area"], plain(option(0, 2))["shot"]) == (None, None, SHOTS[0])
    result = Realised(strokes=3, won=1, low=0, high=1, others=6, others_won=2)
    assert plain([result])[0] == {"strokes": 3, "won": 1, "low": 0, "high": 1, "others": 6, "others_won": 2}
    assert result.confirms


def test_names_as_people_type_them() -> None:
    known = ["viktor-axelsen", "chen-long", "Long Chen"]
    names = ("Viktor Axelsen", "AXELSEN_viktor", "viktor-axelsen", "Long Chen", "LONG chen", "chen")
    assert [_as_known(name, known) for name in names] == [*known[:1] * 3, "Long Chen", "chen-long", "chen"]


def test_the_form_of_a_player_in_dated_matches() -> None:
    strokes = strokes_of("ABw", "BAf", "Aw", "Bw", match="1112")
    names = pa.array(["x 2025-03-01" if name == "1" else "y" for name in strokes["match"].to_pylist()])
    strokes = strokes.set_column(0, STROKES.field("match"), names)
    shot = np.array([SERVE, SMASH, SERVE, LIFT, SERVE, SERVE])
    plays = plays_of(6, shot=shot, fault=np.array([0, 0, 0, 1.0, 0, 0]), winner=np.array([0, 1.0, 0, 0, 1, 1]))
    [form] = season(strokes, plays, "A")
    assert (form.day, form.against, form.rallies, form.strokes) == (datetime.date(2025, 3, 1), "B", 3, 3)
    assert form.won == pytest.approx((1 / 3, *interval(1 / 3, 3)))
    assert (form.fault.value, form.winner.value, form.attack.value) == pytest.approx((1 / 3, 1 / 3, 0))
    [other] = season(strokes, plays, "B")
    assert (other.attack.value, other.winner.value, other.won.value) == pytest.approx((1 / 2, 1 / 2, 2 / 3))
    assert season(strokes, plays, "C") == []


def test_results_of_an_advised_stroke_beside_the_others_there() -> None:
    n = 2 * RELIABLE + 4
    strokes = strokes_of(*["ABw" if i < RELIABLE + 4 else "ABf" for i in range(n)])
    shot = np.tile([SERVE, LIFT], n)
    shot[1 : 2 * RELIABLE : 2] = SMASH  # as many smashes as count, all won, and four of the lifts
    plays = plays_of(2 * n, shot=shot, incoming=np.tile([NONE, SERVE], n), met=np.tile([-1, 4], n), contact=np.tile([0, 1], n))
    advice: Any = [
        SimpleNamespace(situation=place, stroke=0) for place in ((SERVE, 4, 1), (SERVE, 4, 0), (SERVE, 3, 1), (-1, -1, 0))
    ]
    pair: Any = SimpleNamespace(catalogue=SimpleNamespace(shot=np.array([SMASH, SERVE])))
    found = realised(plays, strokes, advice, pair)
    low, high = interval(1.0, RELIABLE)
    assert found == [Realised(strokes=20, won=20, low=low, high=high, others=24, others_won=4), None, None, None]
    served: Any = [SimpleNamespace(situation=(-1, -1, 0), stroke=1)]
    result = realised(plays, strokes, served, pair)[0]
    assert result is not None
    assert (result.strokes, result.won, result.others, result.others_won) == (n, RELIABLE, 0, 0), "served by who lost the winners"
    plays.shot[1] = LIFT
    assert realised(plays, strokes, advice[:1], pair) == [None], "one smash less is too few"


def test_questions_have_answers_in_the_order_of_a_tally() -> None:
    plays, _ = some_plays(60, 6)
    found = tally(plays)
    assert isinstance(found, Tally)
    assert len(found.counts) == sum(len(question.answers) for question in QUESTIONS)
    assert found.dispersion.shape == (len(QUESTIONS),)
    for shot, technique in itertools.product(range(len(SHOTS)), range(4)):
        rows = (plays.shot == shot) & (plays.technique == technique)
        assert found.ends[shot, technique].tolist() == [rows.sum(), plays.fault[rows].sum(), plays.winner[rows].sum()]
