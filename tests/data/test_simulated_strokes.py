"""Simulated stroke tables: they obey the schema, the rules, the game's probabilities and plain geometry."""

from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.analysis import strokes_of_log
from shuttle_marl.analysis.strokes import SimulationError, simulate, simulated_rallies
from shuttle_marl.data.schema import STROKES, Account, violations
from shuttle_marl.data.table import load_account, read_matches, write_parquet
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import from_pair_probabilities
from shuttle_marl.recording import RallyLog, RallyLogWriter, replay
from shuttle_marl.recording.replay import check
from tests.reduced import reduced_game


def uniform(game: Game) -> np.ndarray:
    return 1.0 / np.diff(game.pair_start)[game.pair_state]


def always(game: Game, stroke: str) -> np.ndarray:
    """Plays one stroke wherever it is legal, otherwise anything."""
    chosen = game.pair_stroke == game.catalogue.index(stroke)
    has = np.bincount(game.pair_state, weights=chosen, minlength=game.n_states) > 0
    return np.where(has[game.pair_state], chosen, uniform(game))


GAME = reduced_game()
PLAYERS = {"viktor-axelsen": uniform(GAME), "chen-long": uniform(GAME), "chou-tien-chen": uniform(GAME)}


def test_it_is_a_sound_stroke_table(tmp_path) -> None:
    strokes = simulate(GAME, PLAYERS, matches=7, seed=5)
    assert strokes.schema.equals(STROKES)
    assert [str(v) for v in violations(strokes)] == []
    account = Account.of(strokes)
    assert account.matches == 7
    assert account.strokes == account.strokes_kept == strokes.num_rows
    assert account.area_agreement is None
    write_parquet(strokes, tmp_path / "s.parquet", account=account, provenance={})
    assert read_matches(tmp_path / "s.parquet").equals(strokes)
    assert load_account(tmp_path / "s.parquet") == account


def test_the_seed_decides_everything() -> None:
    once, again, other = (simulate(GAME, PLAYERS, matches=2, seed=seed) for seed in (1, 1, 2))
    assert once.equals(again)
    assert not once.equals(other)


def test_a_log_of_the_rallies_plays_again(tmp_path: Path) -> None:
    players = {
        "average": always(GAME, GAME.catalogue.names[np.bincount(GAME.base_pair_stroke).argmax()]),
        **PLAYERS,
        "chen-yufei": uniform(GAME),
    }
    header, rallies = simulated_rallies(GAME, players, matches=8, seed=2)
    with RallyLogWriter(tmp_path / "a.mcap", header) as log:
        log.append(rallies)
    assert check(tmp_path / "a.mcap", GAME).problems == ()
    with RallyLog(tmp_path / "a.mcap") as log:
        assert replay(log, GAME, {name: from_pair_probabilities(GAME, p) for name, p in players.items()}).wrong == ()
        assert replay(log, GAME, dict.fromkeys(players, from_pair_probabilities(GAME, uniform(GAME)))).wrong != ()
        found = strokes_of_log(log, rallies=10**9)
    table = simulate(GAME, players, matches=8, seed=2)
    assert set(table["discipline"].to_pylist()) == {"MS", "WS"}
    decided = [name for name in STROKES.names if name in ("discipline", "player", "game", "rally", "shot", "outcome", "points")]
    assert found.select(decided).equals(table.select(decided))


@pytest.mark.parametrize(("players", "told"), [
    ({"a": uniform(GAME)}, "players a: expected at least two of one discipline"),
    ({}, "players none"),
    ({"chen-long": uniform(GAME), "chen-yufei": uniform(GAME)}, "at least two of one discipline"),
    ({"a": uniform(GAME), "b": uniform(GAME)[:-1]}, f"player 'b': expected {GAME.n_pairs} probabilities"),
    ({"a": uniform(GAME), "b": -uniform(GAME)}, "none negative"),
    ({"a": uniform(GAME), "b": uniform(GAME) / 2}, "player 'b': probabilities sum to 0.5, not 1, in state: own "),
])  # fmt: skip
def test_what_cannot_be_simulated(players: dict[str, np.ndarray], told: str) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate(GAME, players, matches=1, seed=0)
    assert told in str(caught.value)
