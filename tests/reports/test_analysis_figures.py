"""Figures of reports, each counted again in a plain way: options, habits, endings, rallies, values, places and forms."""

import datetime
import math
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from scipy import stats

from shuttle_marl.data.schema import STROKES
from shuttle_marl.dynamics.habits import NONE, Plays, Tally, questions, tally
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from shuttle_marl.reports.habits import (
    SERVING,
    Results,
    Situation,
    discoveries,
    endings,
    expected_of,
    habits,
    interval,
    options_of,
)
from shuttle_marl.reports.scouting import season
from shuttle_marl.reports.summary import AnalysisError, rally_table, summarise, won_or_lost
from tests.reports.played import strokes_of

SERVE, LIFT, CLEAR, DROP, SMASH = (SHOTS.index(name) for name in ("short-serve", "lift", "clear", "drop", "smash"))


def plays_of(n: int, **columns: Any) -> Plays:
    """Lifts answered by lifts, of which nothing else is known, with some other columns."""
    usual: dict[str, Any] = {
        **{name: np.full(n, LIFT) for name in ("own", "incoming", "shot")},
        **{name: np.full(n, -1) for name in ("met", "area", "waits")},
        **{name: np.zeros(n, np.int64) for name in ("contact", "technique", "group", "hurried")},
        **{name: np.zeros(n, np.bool_) for name in ("fault", "winner", "opposite")},
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
        contact=rng.integers(0, 2, n), met=rng.integers(-1, 2, n), fault=end < 0.3 + 0.3 * (shot == SMASH),
        winner=end > 0.9, own=rng.choice([SERVE, LIFT], n),
    )  # fmt: skip
    return found, won


def exact(*counts: float) -> float:
    """Fisher's p-value of two shares, each a number of successes and of strokes."""
    a, n, b, m = map(round, counts)
    return float(stats.fisher_exact([[a, n - a], [b, m - b]]).pvalue)


def test_options_are_those_that_a_plain_count_finds() -> None:
    plays, won = some_plays(1800, 1)
    mine, rally = np.arange(1800) < 1500, np.arange(1800) // 2
    last: dict[tuple[Any, ...], tuple[int, float]] = {}
    for i in np.flatnonzero(mine & np.isfinite(won)).tolist():
        came, met, contact, hurried = (int(getattr(plays, name)[i]) for name in ("incoming", "met", "contact", "hurried"))
        if came == NONE and plays.shot[i] < 2:
            last[rally[i], SERVING] = plays.shot[i], won[i]
        elif came < NONE and met >= 0 and hurried >= 0:
            last[rally[i], Situation(came, met, contact, hurried == 1)] = plays.shot[i], won[i]
    expected = {}
    for place, shot in {(place, shot) for (_, place), (shot, _) in last.items()}:
        one, rest = ([w for (_, at), (s, w) in last.items() if at == place and (s == shot) == same] for same in (True, False))
        if min(len(one), len(rest)) >= RELIABLE:
            counts = len(one), int(sum(one)), len(rest), int(sum(rest))
            table = [[counts[1], counts[0] - counts[1]], [counts[3], counts[2] - counts[3]]]
            expected[place, shot] = counts, stats.fisher_exact(table).pvalue
    (found,) = options_of([Results(plays, won, rally, mine, np.zeros(1800, np.int64))])
    corrected = dict(zip(expected, stats.false_discovery_control([p for _, p in expected.values()]), strict=True))
    assert {(each.situation, each.shot) for each in found} == expected.keys()
    for each in found:
        counts, p = expected[each.situation, each.shot]
        assert (each.rallies, each.won, each.others, each.others_won) == counts
        assert (each.p, each.q) == pytest.approx((p, corrected[each.situation, each.shot]))
        assert (each.low, each.high) == pytest.approx(interval(each.won / each.rallies, each.rallies))
        assert each.clear == (each.q <= 0.05 and abs(each.gain) >= 0.03)
    assert [each.q for each in found] == sorted(each.q for each in found)
    assert {each.clear for each in found} == {False, True}


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
            p = exact(a / scale, n / scale, b / scale, m / scale)
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
    expected: dict[tuple[str, ...], list[tuple[Any, ...]]] = {}
    for shot, technique in kinds:
        rows = [each.shot == SHOTS.index(shot) for each in (mine, others)]
        if technique is not None:
            rows = [row & (each.technique == TECHNIQUES.index(technique)) for row, each in zip(rows, (mine, others), strict=True)]
        n, m = (int(each.sum()) for each in rows)
        if min(n, m) >= RELIABLE:
            kind = (shot,) if technique is None else (shot, technique)
            expected[kind] = [
                (n, m, each.fault[row].sum(), each.winner[row].sum()) for each, row in zip((mine, others), rows, strict=True)
            ]
    found = endings(tally(mine), tally(others))
    assert [(each.kind, *each.about) for each in found] == [(end, *kind) for kind in expected for end in ("fault", "winner")]
    p = []
    for each in found:
        (n, m, *ends), (_, _, *usual) = expected[each.about]
        a, b = (counts[each.kind == "winner"] for counts in (ends, usual))
        assert (each.strokes, each.share, each.low, each.high, each.usual) == pytest.approx(
            (n, a / n, *interval(a / n, n), b / m)
        )
        p.append(exact(a, n, b, m))
    assert [each.p for each in found] == pytest.approx(p)
    least = [abs(each.share - each.usual) >= 0.03 for each in found]
    assert [each.clear for each in found] == (discoveries(p) & least).tolist()
    assert [each.q for each in found] == pytest.approx(stats.false_discovery_control(p))
    assert {each.clear for each in found} == {False, True}
    assert endings(tally(mine.take(np.arange(500) < 19)), tally(others)) == []
    same = tally(plays_of(30))
    assert [each.clear for each in endings(same, same)] == [False] * 4, "no ending at all"


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
    assert np.flatnonzero(seen.areas).tolist() == [2, 7, 8], "good strokes in court, seen by a left-handed B in the mirror"
    assert seen.areas.sum() == pytest.approx(1)
    assert summarise(strokes_of("Aw")).shots[SERVE] == 1
    with pytest.raises(AnalysisError, match="no strokes of C; players are A, B"):
        summarise(strokes, "C")


def test_the_form_of_a_player_in_dated_matches() -> None:
    strokes = strokes_of("ABw", "BAf", "Aw", "Bw", match="1112")
    names = pa.array(["x 2025-03-01" if name == "1" else "y" for name in strokes["match"].to_pylist()])
    strokes = strokes.set_column(0, STROKES.field("match"), names)
    shot = np.array([SERVE, SMASH, SERVE, LIFT, SERVE, SERVE])
    plays = plays_of(6, shot=shot, fault=np.arange(6) == 3, winner=np.isin(np.arange(6), (1, 4, 5)))
    [form] = season(strokes, plays, "A")
    assert (form.day, form.against, form.points, form.strokes) == (datetime.date(2025, 3, 1), "B", 3, 3)
    assert form.won == pytest.approx((1 / 3, *interval(1 / 3, 3)))
    assert (form.fault.value, form.winner.value, form.attack.value) == pytest.approx((1 / 3, 1 / 3, 0))
    [other] = season(strokes, plays, "B")
    assert (other.attack.value, other.winner.value, other.won.value) == pytest.approx((1 / 2, 1 / 2, 2 / 3))
    assert season(strokes, plays, "C") == []
