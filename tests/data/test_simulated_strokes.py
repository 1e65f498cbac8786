"""Simulated stroke tables: they obey the schema, the rules, the game's probabilities and plain geometry."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import REASONS, STROKES, Account, Outcome, violations
from shuttle_marl.data.simulated import (
    FRAME_RATE,
    SimulatedStrokes,
    SimulationError,
    sample_positions,
    simulate,
    simulated_rallies,
    stroke_table,
)
from shuttle_marl.data.table import load_counted, read_matches, write_parquet
from shuttle_marl.game import court, draws
from shuttle_marl.game.pairs import Looks
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.rally import columns_of
from shuttle_marl.game.stroke import N_SERVES, SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.recording import RallyLog, RallyLogWriter, replay
from shuttle_marl.recording.header import LogHeader, Player
from shuttle_marl.recording.reader import check
from shuttle_marl.reports import strokes_of_log
from tests import golden
from tests.reduced import reduced_game


def evenly(game: Game) -> np.ndarray:
    return 1.0 / np.diff(game.pair_start)[game.pair_state]


def uniform(game: Game) -> TabulatedPolicy:
    return from_pair_probabilities(game, evenly(game))


def always(game: Game, stroke: str) -> TabulatedPolicy:
    """Plays one stroke wherever it is legal, otherwise anything."""
    chosen = game.pair_stroke == game.catalogue.index(stroke)
    has = np.bincount(game.pair_state, weights=chosen, minlength=game.n_states) > 0
    return from_pair_probabilities(game, np.where(has[game.pair_state], chosen, evenly(game)))


@pytest.fixture(scope="module")
def small() -> Game:
    return reduced_game()


@pytest.fixture(scope="module")
def players(small: Game) -> dict[str, TabulatedPolicy]:
    return {"viktor-axelsen": uniform(small), "chen-long": uniform(small), "chou-tien-chen": uniform(small)}


def test_it_is_a_sound_stroke_table(tmp_path, small: Game, players: dict[str, TabulatedPolicy]) -> None:
    strokes = simulate(small, players, matches=7, seed=5)
    assert strokes.schema.equals(STROKES)
    assert [str(v) for v in violations(strokes)] == []
    account = Account.of(strokes)
    assert account.matches == 7
    assert account.strokes == account.strokes_kept == strokes.num_rows
    assert account.area_agreement is None
    write_parquet(strokes, tmp_path / "s.parquet", account=account, provenance={})
    assert read_matches(tmp_path / "s.parquet").equals(strokes)
    assert load_counted(tmp_path / "s.parquet")[1] == account


def test_the_seed_decides_everything(small: Game, players: dict[str, TabulatedPolicy]) -> None:
    once, again, other = (simulate(small, players, matches=2, seed=seed) for seed in (1, 1, 2))
    assert once.equals(again)
    assert not once.equals(other)


def test_a_log_of_the_rallies_plays_again(tmp_path: Path, small: Game, players: dict[str, TabulatedPolicy]) -> None:
    players = {
        "average": always(small, small.catalogue.names[np.bincount(small.base_pair_stroke).argmax()]),
        **players,
        "chen-yufei": uniform(small),
    }
    rallies, names = simulated_rallies(small, players, matches=8, seed=2), [*players]
    first = np.unique(rallies.pairing, return_index=True)[1]
    header = LogHeader(
        seed=2,
        game=small.hash,
        strokes=small.catalogue.names,
        policies=tuple(Player(name=name, hash="") for name in names),
        pairings=tuple(draws.pairing_key(*(names[k] for k in pair)) for pair in rallies.policy[first].tolist()),
        matches_per_draw=1,
        columns=columns_of(small),
    )
    with RallyLogWriter(tmp_path / "a.mcap", header) as log:
        log.append(rallies)
    assert check(tmp_path / "a.mcap", small).problems == ()
    with RallyLog(tmp_path / "a.mcap") as log:
        assert replay(log, small, players).wrong == ()
        assert replay(log, small, dict.fromkeys(players, uniform(small))).wrong != ()
        found = strokes_of_log(log, rallies=10**9)
    table = simulate(small, players, matches=8, seed=2)
    assert set(table["discipline"].to_pylist()) == {"MS", "WS"}
    decided = [name for name in STROKES.names if name in ("discipline", "player", "game", "rally", "shot", "outcome", "points")]
    assert found.select(decided).equals(table.select(decided))


def test_at_least_one_match_is_simulated_and_probabilities_are_rounded(small: Game, players: dict[str, TabulatedPolicy]) -> None:
    with pytest.raises(SimulationError, match="0 matches: expected at least one"):
        simulate(small, players, matches=0, seed=0)
    rounded = dict(zip("ab", (from_pair_probabilities(small, evenly(small) * (1 + by)) for by in (0.9e-6, -0.9e-6)), strict=True))
    assert simulate(small, rounded, matches=1, seed=0).equals(
        simulate(small, dict.fromkeys("ab", uniform(small)), matches=1, seed=0)
    )
    for wrong in (1 + 1.1e-6, 1 - 1.1e-6):
        with pytest.raises(PolicyError, match="probabilities sum to"):
            from_pair_probabilities(small, evenly(small) * wrong)


def every_kind() -> SimulatedStrokes:
    """Rallies of a serve and one to five strokes of every shot type, to all areas in turn, and with all endings."""
    rows: list[tuple[int, int, int, int]] = []
    for number in range(480):
        length = 1 + number % 6
        for i in range(length):
            ends = Outcome.WINNER if number % 4 == 1 else Outcome.FAULT
            shot = number % N_SERVES if i == 0 else N_SERVES + (number + 3 * i) % (len(SHOTS) - N_SERVES)
            rows.append((shot, (number + 2 * i) % 9, ends if i == length - 1 else Outcome.RETURNED, i + 1))
    shot, area, outcome, stroke = np.array(rows, dtype=np.int64).T
    first, number_of = stroke == 1, np.cumsum(stroke == 1)
    new_game, right = first & (number_of % 50 == 1), number_of % 3 == 0
    return SimulatedStrokes(shot=shot, area=area, outcome=outcome, stroke=stroke, new_game=new_game, right=right)


def test_places_and_times_are_the_written_ones() -> None:
    strokes = every_kind()
    places, reason, frame = sample_positions(strokes, np.random.default_rng(4))
    some = [0, 1, 2, 20, 21, 22, 23]
    found = {name: [golden.weighted_sum(np.nan_to_num(points)), points[some]] for name, points in places.items()}
    tallied = {SHOTS[shot]: np.bincount(reason[strokes.shot == shot], minlength=len(REASONS)) for shot in range(len(SHOTS))}
    golden.check("simulated_strokes", {**found, "reasons": tallied, "frame": [frame[some], golden.weighted_sum(frame)]}, 1e-3)


def test_places_fit_their_outcome() -> None:
    """Good strokes lie within their area, out faults behind a line next to it, the others on the striker's side of the net."""
    strokes = every_kind()
    places, reason, frame = sample_positions(strokes, np.random.default_rng(1))
    (x, y), names = places["landing"].T, np.array(REASONS)[reason]
    good, serve = strokes.outcome != Outcome.FAULT, strokes.shot < N_SERVES
    assert set(names[good]) == {"returned", "landed"}
    assert set(names[~good]) == {"out", "net", "short"}
    # A serve to the front lands beyond the service line, in whichever third that is.
    deep = good & ~(serve & (strokes.area < 3))
    assert np.array_equal(court.area_of(x[deep], y[deep]), strokes.area[deep])
    assert y[good & serve].min() >= court.SHORT_SERVICE
    assert court.in_court(x[good], y[good]).all()
    fallen = np.isin(names, ("net", "short"))
    assert -3.0 <= y[fallen].min() < y[fallen].max() <= -0.02
    out = names == "out"
    assert not np.isin(strokes.area[out], (1, 4)).any()
    beyond = np.maximum(np.abs(x[out]) - court.HALF_WIDTH, y[out] - court.HALF_LENGTH)
    assert 0.03 <= beyond.min() < beyond.max() <= 1.0
    # The contact of a reply is the landing before it, seen from the other side; a serve has none.
    replies = np.flatnonzero(strokes.stroke > 1)
    assert np.array_equal(places["contact"][replies], -places["landing"][replies - 1])
    assert np.isnan(places["contact"][strokes.stroke == 1]).all()
    assert np.linalg.norm(places["striker"][replies] - places["contact"][replies], axis=1).max() < 1.1 + 1e-9
    assert places["striker"][:, 1].max() <= -0.3
    assert (np.diff(frame) > 0).all()


def test_players_look_as_their_names_tell_and_left_handers_see_the_other_side(
    small: Game, players: dict[str, TabulatedPolicy]
) -> None:
    asked: list[tuple[str, str]] = []

    def looks(game: Game, names: tuple[str, str]) -> Looks:
        assert game is small
        asked.append(names)
        return Looks(hands=("left" if names[0] == "chen-long" else "right", "left" if names[1] == "chen-long" else "right"))

    table, plain = simulate(small, players, matches=5, seed=5, looks=looks), simulate(small, players, matches=5, seed=5)
    assert set(asked) == set(itertools.combinations(players, 2))
    left, opposed = ([name == "chen-long" for name in table[column].to_pylist()] for column in ("player", "opponent"))
    assert table["hand"].to_pylist() == list(map(int, left))
    good = np.flatnonzero(plain["outcome"].to_numpy() != Outcome.FAULT)
    seen, usual = (each["area"].to_numpy(zero_copy_only=False)[good] for each in (table, plain))
    assert np.array_equal(seen, np.where(np.array(opposed)[good], court.mirrored(usual), usual))


def test_matches_have_their_names_and_begin_at_no_time(small: Game, players: dict[str, TabulatedPolicy]) -> None:
    table, pairs = simulate(small, players, matches=4, seed=5), [*itertools.combinations(players, 2)]
    seats = [pairs[i % 3] for i in range(4)]
    names = [f"simulated-{i + 1}-{a}-{b}" for i, (a, b) in enumerate(seats)]
    assert {*table["match"].to_pylist()} == {*names}
    for i, name in enumerate(names):
        rows = table.filter(pc.equal(table["match"], name))
        first = rows.slice(0, 1).to_pylist()[0]
        # Servers change from match to match.
        assert (first["player"], first["opponent"]) == (seats[i] if i % 2 == 0 else seats[i][::-1])
        assert (first["frame"], first["clock"], first["game"], first["rally"], first["stroke"]) == (0, 0, 1, 1, 1)
        frame = rows["frame"].to_numpy()
        assert (np.diff(frame) > 0).all()
        assert np.array_equal(rows["clock"].to_numpy(), frame // 30)
        # Points are those after the rally.
        total = rows["points"].to_numpy() + rows["points_opponent"].to_numpy()
        assert np.array_equal(total, rows["rally"].to_numpy())
        last = np.append(np.diff(rows["rally"].to_numpy()) != 0, True)
        ahead = np.flatnonzero(last & (rows["outcome"].to_numpy() == Outcome.WINNER) & (rows["rally"].to_numpy() == 1))
        assert (rows["points"].to_numpy()[ahead] == 1).all()


def test_servers_of_a_table_stand_where_their_points_tell(small: Game) -> None:
    serve = "short-serve:front-centre:below:backhand"
    table = simulate(small, dict.fromkeys("ab", always(small, serve)), matches=1, seed=0)
    rows = table.filter(pc.equal(table["stroke"], 1)).to_pylist()
    asked = [row for row in rows if abs(row["striker_x"]) > 0.15 and row["outcome"] == Outcome.RETURNED]
    ends = {row["rally"] + 100 * row["game"]: row for row in table.to_pylist()}
    assert len(asked) > 20
    for row in asked:
        last = ends[row["rally"] + 100 * row["game"]]
        won = (last["outcome"] == Outcome.WINNER) == (last["player"] == row["player"])
        assert (row["striker_x"] > 0) == ((row["points"] - won) % 2 == 0)


def test_a_later_match_alone_begins_at_no_time(small: Game) -> None:
    rallies = simulated_rallies(small, dict.fromkeys("ab", uniform(small)), matches=2, seed=0)
    for number in (0, 1):
        part = rallies.select(rallies.match == number)
        names, titles = ("a", "b"), [f"match {number}"] * len(part)
        found = stroke_table(part, small.catalogue, names, titles, np.random.default_rng(0), looks=lambda _: Looks())
        frame, game = found["frame"].to_numpy(), found["game"].to_numpy()
        assert (frame[0], game[0]) == (0, 1)
        pauses = np.diff(frame)[np.diff(game) != 0] / FRAME_RATE
        assert len(pauses) >= 1
        assert pauses.min() > 50


def test_a_rally_longer_than_any_match_has_is_refused(small: Game) -> None:
    rally = simulated_rallies(small, dict.fromkeys("ab", uniform(small)), matches=1, seed=0).slice(0, 1)
    times = 10_000
    long = dataclasses.replace(
        rally, length=rally.length * times, stroke=np.tile(rally.stroke, times), hurried=np.tile(rally.hurried, times)
    )
    with pytest.raises(ShuttleError, match="strokes, which no match has"):
        stroke_table(long, small.catalogue, ("a", "b"), ["m"], np.random.default_rng(0), looks=lambda _: Looks())


def test_a_match_is_filed_under_the_discipline_of_a_player_who_has_one(small: Game) -> None:
    for names, kind in ((("a", "chen-yufei"), "WS"), (("chen-yufei", "a"), "WS"), (("a", "b"), "MS"), (("a", "chen-long"), "MS")):
        table = simulate(small, dict.fromkeys(names, uniform(small)), matches=1, seed=0)
        assert set(table["discipline"].to_pylist()) == {kind}
