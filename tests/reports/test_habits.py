"""Habits and options are said only where they are more than chance, and advice only where nothing speaks against it."""

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from scipy import stats

from shuttle_marl.base.files import seal
from shuttle_marl.data.schema import rally_numbers
from shuttle_marl.dynamics.habits import NONE, Plays, load_habits, plays_of_strokes, questions, save_habits, tally
from shuttle_marl.game import court
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.pairs import load_skill
from shuttle_marl.game.shipped import CARD, HABITS, Estimate, model_folder
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports.habits import (
    FALSE_DISCOVERIES,
    SERVING,
    Advised,
    Results,
    Situation,
    discoveries,
    endings,
    habits,
    is_short,
    options_of,
)
from shuttle_marl.reports.match import matches_in
from shuttle_marl.reports.scouting import EARNED, earned, scout
from shuttle_marl.reports.value import calibrated, error_of
from tests.reports.conftest import A, with_hand


def test_a_gain_is_reduced_to_what_matches_realise() -> None:
    assert error_of(np.array([0.0, 2.0])) == pytest.approx(3**0.5)
    assert np.isnan(error_of(np.zeros(1)))
    gains = np.array([0.01, 0.012, 0.008, 0.01])
    whole = calibrated(gains, None)
    assert whole.value == pytest.approx(0.01)
    spread = np.std(gains, ddof=1) * np.sqrt(1.25) * 1.6448536
    assert whole.high - whole.value == pytest.approx(spread)
    part = calibrated(gains, Estimate(0.75, 0.75 - 0.196, 0.75 + 0.196))
    assert part.value == pytest.approx(0.0075)
    assert part.high - part.value == pytest.approx(np.hypot(0.75 * spread, 0.01 * 0.1 * 1.6448536), rel=1e-4)


def test_a_forecast_is_no_larger_than_it_has_earned() -> None:
    p = np.array([0.2, 0.5, 0.6])
    assert earned(p) == pytest.approx(1 / (1 + (p / (1 - p)) ** -EARNED))
    assert (np.abs(earned(p) - 0.5) <= np.abs(p - 0.5)).all()


REPORTS = 100
SERVE, LIFT, CLEAR, DROP, SMASH = (SHOTS.index(name) for name in ("short-serve", "lift", "clear", "drop", "smash"))


def test_options_are_compared_within_one_situation() -> None:
    """Twenty rallies with each of two shots in two situations, which a shot alone does not tell apart."""
    # Clears win all rallies from the rear forehand corner and none from the backhand one, as drops do: only the situation counts.
    some = plays([(SERVE, LIFT, area, 1, shot, 6) for area in (6, 8) for shot in (CLEAR, DROP)], 20)
    easy, mine = some.met == 6, np.ones(len(some), bool)
    for result, clear in ((easy.astype(float), False), ((some.shot == CLEAR).astype(float), True)):
        (found,) = options_of([Results(some, result, np.arange(len(some)), mine, 0 * some.shot)])
        assert {(each.situation, each.shot) for each in found} == {
            (Situation(LIFT, area, 1, False), shot) for area in (6, 8) for shot in (CLEAR, DROP)
        }
        for each in found:
            assert (each.rallies, each.others, each.clear) == (20, 20, clear)
            assert each.q >= each.p


def test_strong_players_do_not_make_their_strokes_good() -> None:
    """One player wins 90 of 100 rallies and mostly smashes, another 10 and mostly drops, with either stroke alike."""
    some, number = plays([(SERVE, LIFT, 6, 1, SMASH, 6)], 200), np.arange(200)
    striker = number // 100
    some.shot[:] = np.where((number % 10 == 0) ^ (striker == 1), DROP, SMASH)
    won = ((number // 10 % 10 > 0) ^ (striker == 1)).astype(float)
    one, each = (options_of([Results(some, won, number, striker >= 0, who)])[0] for who in (0 * striker, striker))
    assert [option.clear for option in one] == [True, True]
    assert [option.clear for option in each] == [False, False]
    assert [option.p for option in each] == pytest.approx([1.0, 1.0])
    assert options_of([Results(some, won, number, striker == 0, striker)]) == [[]]  # ten of a kind are too few


def test_a_rally_counts_once_by_the_last_stroke_in_the_situation() -> None:
    some = plays([(SERVE, LIFT, 6, 1, CLEAR, 6), (CLEAR, LIFT, 6, 1, DROP, 0)], 25)
    rally, won = np.arange(len(some)) // 2, np.tile([1.0, 1.0], 25)
    results = Results(some, won, rally, np.ones(len(some), bool), 0 * some.shot)
    here = Situation(LIFT, 6, 1, False)
    assert (results.of(here, CLEAR), results.of(here, DROP)) == ((0, 0), (25, 25))
    assert results.options() == []  # nothing to compare with
    hurried = dataclasses.replace(some, hurried=np.tile([1, 0], 25))
    both = Results(hurried, won, rally, np.ones(len(some), bool), 0 * some.shot)
    assert (both.of(here._replace(hurried=True), CLEAR), both.of(here, DROP)) == ((25, 25), (25, 25))
    unknown = dataclasses.replace(some, hurried=np.full(50, -1))
    assert Results(unknown, won, rally, np.ones(len(some), bool), 0 * some.shot).of(here, DROP) == (0, 0)


def test_advice_agrees_with_the_results_and_with_other_advice() -> None:
    rows = [(NONE, NONE, -1, 0, shot, 1) for shot in (SERVE, SERVE + 1)]
    some = plays(rows, 10)  # short serves win 3 of 10, long ones 5
    won = np.array([[i < 3, i < 5] for i in range(10)]).ravel().astype(float)
    results = Results(some, won, np.arange(20), np.ones(20, bool), 0 * some.shot)
    serve = Advised(0, SERVING, (SERVE, 1), (SERVE + 1, 7))
    assert not serve.agrees(results, ())
    assert serve._replace(better=serve.worse, worse=serve.better).agrees(results, ())
    here = Situation(LIFT, 6, 1, False)  # never met in these rallies
    smash = Advised(0, here, (SMASH, 3), (CLEAR, 6))
    assert smash.agrees(results, [smash._replace(player=1, better=(SMASH, 5)), smash._replace(situation=here._replace(area=8))])
    for other in (
        smash._replace(better=(SMASH, 5)),  # to another area
        smash._replace(better=(DROP, 0), worse=(SMASH, -1)),  # never
        smash._replace(better=(CLEAR, -1), worse=(DROP, 0)),  # what it replaces
    ):
        assert not smash.agrees(results, [other])


def test_clears_and_lifts_are_meant_for_the_rear_court() -> None:
    middle = AREAS.index("middle-centre")
    assert is_short(np.array([CLEAR, DROP]), np.array([middle, middle])).tolist() == [True, False]
    assert not is_short(CLEAR, -1)


def plays(rows: list[tuple[int, int, int, int, int, int]], copies: int = 1, *, opposite: bool = False) -> Plays:
    """Strokes of own shot, incoming shot, area where they are met, contact, shot and area; opposite: to the other hand."""
    own, incoming, met, contact, shot, area = np.array(rows * copies, dtype=np.int64).T
    none = np.zeros(len(own), bool)
    return Plays(
        own=own, incoming=incoming, met=met, contact=contact, shot=shot, technique=contact, area=area,
        hurried=none.astype(np.int64), waits=none - 1, opposite=np.full(len(own), opposite), fault=none, winner=none,
        group=np.zeros(len(own), np.int64),
    )  # fmt: skip


def answers(some: Plays, kind: str, about: tuple[str, ...] = ()) -> list[str | None]:
    for question, answer in questions(some):
        if (question.kind, question.about) == (kind, about):
            return [None if a < 0 else question.answers[a] for a in answer.tolist()]
    raise AssertionError(kind)


def test_questions_of_three_strokes() -> None:
    serve, lift, smash = (SHOTS.index(name) for name in ("short-serve", "lift", "smash"))
    back_right, middle_left, middle_right = (AREAS.index(name) for name in ("back-right", "middle-left", "middle-right"))
    rows = [
        (NONE, NONE, -1, 0, serve, 1),
        (NONE, serve, 1, 0, lift, back_right),
        # From one's own right side, the receiver's left is straight ahead.
        (serve, lift, back_right, 1, smash, middle_left),
        (serve, lift, back_right, 1, smash, middle_right),
    ]
    some = plays(rows)
    assert answers(some, "serve") == ["short-serve", None, None, None]
    assert answers(some, "serve_side", ("short-serve",)) == ["centre", None, None, None]
    assert answers(some, "return", ("short-serve",)) == [None, "lift", None, None]
    assert answers(some, "third") == [None, None, "smash", "smash"]
    assert answers(some, "reply", ("lift", "above")) == [None, None, "smash", "smash"]
    assert answers(some, "direction", ("smash",)) == [None, None, "straight", "cross"]
    assert answers(some, "shots") == [None, "lift", "smash", "smash"]
    found = tally(some)
    assert found.targets.sum() == 3
    for number, (question, answer) in enumerate(questions(some)):
        assert found.answers(number).tolist() == [(answer == each).sum() for each in range(len(question.answers))]
    # A left-hander's forehand side is straight ahead of a right-hander's.
    assert answers(plays(rows, opposite=True), "direction", ("smash",)) == [None, None, "cross", "straight"]


def mirror_image(strokes: pa.Table) -> pa.Table:
    """Strokes seen in a mirror along the court: players have the other hand."""
    for name in strokes.column_names:
        if name.endswith("_x"):
            column = pc.negate(strokes[name])
        elif name == "area":
            column = pa.array(court.mirrored(np.arange(9))).take(strokes[name])
        elif name == "hand":
            column = pc.subtract(1, strokes[name])
        else:
            continue
        field = strokes.schema.field(name)
        strokes = strokes.set_column(strokes.schema.get_field_index(name), field, column.cast(field.type))
    return strokes


def test_a_left_hander_plays_as_a_right_hander_in_the_mirror(sample: pa.Table) -> None:
    names = sample["player"].unique().to_pylist()
    for hands in (dict.fromkeys(names, 0), {name: i % 2 for i, name in enumerate(names)}):
        told = with_hand(sample, hands)
        one, other = plays_of_strokes(told), plays_of_strokes(mirror_image(told))
        for field in dataclasses.fields(one):
            assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name
        assert one.opposite.any() == (1 in hands.values())
    unknown = plays_of_strokes(with_hand(sample, dict.fromkeys(names)))
    assert np.array_equal(unknown.area, plays_of_strokes(with_hand(sample, dict.fromkeys(names, 0))).area)


def test_areas_are_on_the_forehand_side_of_who_meets_the_shuttle(sample: pa.Table) -> None:
    match = sample.filter(pc.equal(sample["match"], sample["match"][0]))
    a, b = match["player"].unique().to_pylist()
    right, mixed = (plays_of_strokes(with_hand(match, {a: 0, b: hand})) for hand in (0, 1))
    mine = match["player"].to_numpy(zero_copy_only=False) == a
    # a strikes to b, who sees the other side; b meets the shuttle there, and a where a right-hander does.
    for before, after, turned in ((right.area, mixed.area, mine), (right.met, mixed.met, ~mine)):
        known = before >= 0
        assert np.array_equal(after[known & ~turned], before[known & ~turned])
        assert np.array_equal(after[known & turned], court.mirrored(before[known & turned]))
        assert (after[~known] < 0).all()
    # Where a stroke flies does not depend on who is left-handed.
    for one, other in zip(questions(right), questions(mixed), strict=True):
        if one[0].kind == "direction":
            assert np.array_equal(one[1], other[1])


def test_false_discoveries_are_controlled() -> None:
    assert discoveries([]).tolist() == []
    # Benjamini-Hochberg by hand: the largest i with p_(i) <= 0.05 i / 4 is 2.
    assert discoveries([0.9, 0.02, 0.001, 0.04]).tolist() == [False, True, True, False]


def test_a_difference_is_said_with_its_numbers() -> None:
    serve, lift, net = (SHOTS.index(name) for name in ("short-serve", "lift", "net-shot"))
    mine = plays([(NONE, serve, 1, 0, lift, 6)] * 9 + [(NONE, serve, 1, 0, net, 0)], 10)
    others = plays([(NONE, serve, 1, 0, lift, 6)] * 5 + [(NONE, serve, 1, 0, net, 0)] * 5, 40)
    found = next(h for h in habits(tally(mine), tally(others)) if h.kind == "return" and h.answer == "lift")
    assert found.clear
    assert (found.strokes, found.share, found.usual) == (100, 0.9, 0.5)
    assert found.p == pytest.approx(stats.fisher_exact([[90, 10], [200, 200]]).pvalue)
    few = mine.take(np.arange(len(mine)) < 15)
    assert habits(tally(few), tally(others)) == []


def test_faults_and_winners(sample: pa.Table) -> None:
    some = plays_of_strokes(sample)
    mine = sample["player"].to_numpy(zero_copy_only=False) == "viktor-axelsen"
    listed = endings(tally(some.take(mine)), tally(some.take(~mine)))
    found = {(each.kind, *each.about): each for each in listed}
    smashes = mine & (some.shot == SHOTS.index("smash"))
    for kind, ends in (("fault", some.fault), ("winner", some.winner)):
        assert found[kind, "smash"].strokes == smashes.sum()
        assert found[kind, "smash"].share == pytest.approx(ends[smashes].mean())
    lifts = {technique: found["fault", "lift", *technique].strokes for technique in ((), ("backhand",), ("forehand",))}
    assert lifts["backhand",] == (mine & (some.shot == SHOTS.index("lift")) & (some.technique == 1)).sum()
    assert lifts[()] == lifts["backhand",] + lifts["forehand",]


def test_players_with_equal_habits_are_seldom_told_apart(sample: pa.Table) -> None:
    """Names change at random from rally to rally, and so do winners: whatever a report says of the two is false."""
    rng, said = np.random.default_rng(0), {"habits": 0, "endings": 0, "options": 0}
    for match in (matches := matches_in(sample)[:5]) * (REPORTS // len(matches)):
        part = sample.filter(pc.equal(sample["match"], match))
        some, rally, who = plays_of_strokes(part), rally_numbers(part), part["player"].to_numpy(zero_copy_only=False)
        changed, won = rng.integers(0, 2, (2, rally[-1] + 1))[:, rally]
        seats = [(who == who[0]) ^ (changed == seat) for seat in (0, 1)]
        one, other = (tally(some.take(seat)) for seat in seats)
        said["habits"] += any(each.clear for each in habits(one, other, dispersed=False))
        said["endings"] += any(each.clear for each in endings(one, other))
        results = [Results(some, won.astype(float), rally, seat, 1 * seats[1]) for seat in seats]
        said["options"] += any(each.clear for found in options_of(results) for each in found)
    assert sum(said.values()) <= stats.binom.ppf(0.99, REPORTS, FALSE_DISCOVERIES), said


def test_one_stroke_of_few_is_no_habit() -> None:
    """One fault of 20 beside 1 of 500, for which a normal approximation has a p-value of .0007."""
    few, many = (plays([(NONE, SERVE, 1, 0, LIFT, 6)], n) for n in (20, 500))
    for some in (few, many):
        some.fault[0] = True
    fault, *others = endings(tally(few), tally(many))
    assert (fault.kind, fault.about, fault.share, fault.usual) == ("fault", ("lift",), 0.05, 0.002)
    assert fault.p == pytest.approx(stats.fisher_exact([[1, 19], [1, 499]]).pvalue)
    assert not any(each.clear for each in (fault, *others))


def write_habits(folder: Path, content: bytes) -> None:
    """A model folder with nothing but habits."""
    folder.mkdir()
    (folder / HABITS).write_bytes(content)
    (folder / CARD).write_bytes(seal({"sha256": {HABITS: hashlib.sha256(content).hexdigest()}}))


def test_a_model_and_its_data_say_the_same(sample: pa.Table, model: str, tmp_path: Path) -> None:
    # One agent of the sample plays in both disciplines, which people do not.
    names = [
        f"{name} {kind}" if name == "bc" else name
        for name, kind in zip(*(sample[c].to_pylist() for c in ("player", "discipline")), strict=True)
    ]
    sample = sample.set_column(sample.schema.get_field_index("player"), sample.schema.field("player"), pa.array(names))
    players = sorted(set(sample["player"].to_pylist()))
    save_habits(tmp_path, sample, players)
    folder = tmp_path / "model"
    write_habits(folder, (tmp_path / HABITS).read_bytes())
    assert list(load_habits(folder)) == players
    some, player = plays_of_strokes(sample), sample["player"].to_numpy(zero_copy_only=False)
    own, others = load_habits(folder)[players[0]]
    discipline = sample["discipline"].to_numpy(zero_copy_only=False)
    alike = discipline == discipline[player == players[0]][0]
    for stored, counted in (
        (own, tally(some.take(player == players[0]))),
        (others, tally(some.take(alike & (player != players[0])))),
    ):
        assert np.array_equal(stored.counts, counted.counts)
        assert np.array_equal(stored.ends, counted.ends)
        assert stored.dispersion == pytest.approx(counted.dispersion, rel=1e-3)
    # The shipped model has the habits of all its players; with data, they are counted there.
    shipped = load_habits(model_folder())
    assert set(shipped) == set(load_skill(model_folder()).players)
    clear = [[(h.kind, h.about, h.answer) for h in scout(A, model=model, data=data).habits if h.clear] for data in (None, sample)]
    # The sample is a part of the simulated matches, so a player has no fewer clear habits in the model.
    assert len(clear[0]) >= len(clear[1])


def test_a_damaged_file_of_habits_is_refused(sample: pa.Table, tmp_path: Path) -> None:
    players = sorted(set(sample["player"].to_pylist()))
    save_habits(tmp_path, sample, players)
    content = (tmp_path / HABITS).read_bytes()
    first = players[0].encode()
    for name, damaged in {
        "short": content[:-8],
        "names": content.replace(b"players", b"playerz"),
        "no name": content.replace(b'\\"%s\\"' % first, b"%d" % 10 ** (len(first) + 3)),
    }.items():
        write_habits(tmp_path / name, damaged)
        with pytest.raises(GameError, match="no readable habits of players"):
            load_habits(tmp_path / name)
    with pytest.raises(GameError, match="this model has no habits"):
        load_habits(tmp_path / "nothing")
