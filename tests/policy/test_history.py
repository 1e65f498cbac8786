"""``bc:history``: choices by the rally so far, where they are known, and refusal everywhere else."""

import dataclasses
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.base.tensor_files import tensor_bytes
from shuttle_marl.court.match import PolicyTables, play_rally
from shuttle_marl.court.plan import Side
from shuttle_marl.data.schema import Outcome
from shuttle_marl.data.simulated import simulate, simulated_rallies
from shuttle_marl.dynamics.choices import fit_history
from shuttle_marl.dynamics.evaluate import write_card
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.game.draws import stream
from shuttle_marl.game.layout import observations
from shuttle_marl.game.policy import (
    STAGES,
    HistoryError,
    PolicyError,
    States,
    TemperedPolicy,
    UniformPolicy,
    act,
    checked_probabilities,
    tabulate,
)
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.shipped import HISTORY, load_game, read_model_card
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.league.entrants import default_pool, enter
from shuttle_marl.policy import baselines, registry
from shuttle_marl.policy.baselines import ATTRIBUTES, N_STYLES, HistoryPolicy
from tests.dynamics.rows import plain_rows
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
UNIFORM = tabulate(UniformPolicy(), GAME)
NAMES = ("viktor-axelsen", "kento-momota")
OF_STYLE = np.eye(N_STYLES)[GAME.catalogue.shot.astype(int) * N_TECHNIQUES + GAME.catalogue.technique]
"""``[n, 39]`` shot type and technique of each stroke."""


def shifts(scale: float = 0.0, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shapes: dict[str, tuple[int, ...]] = {name: (2, size + 1, N_STYLES + 9) for name, size in ATTRIBUTES.items()}
    shapes |= {name: (size, N_STYLES + 9) for name, size in STAGES.items()}
    return {name: (scale * rng.normal(size=shape)).astype(np.float16) for name, shape in shapes.items()}


def player(scale: float = 0.0) -> HistoryPolicy:
    return HistoryPolicy.of(UNIFORM, shifts(scale))


def some_states(seed: int = 0) -> States:
    rng = np.random.default_rng(seed)
    playable = np.flatnonzero(GAME.playable)
    past = rng.integers(0, GAME.n_strokes + 1, (500, 4), dtype=np.int32)
    return States(game=GAME, state=rng.choice(playable, 500).astype(np.int32), history=past)


def test_shifts_move_legal_strokes_only_and_none_of_them_changes_nothing() -> None:
    states = some_states()
    base = UNIFORM.probabilities(states)
    assert np.allclose(checked_probabilities(player(), states), base, rtol=0, atol=1e-12)
    moved = checked_probabilities(player(1.0), states)
    assert ((moved > 0) == (base > 0)).all()
    assert np.abs(moved - base).max() > 0.2


def test_the_two_strokes_that_the_state_holds_are_not_read_again() -> None:
    states = some_states()
    past = states.history.copy()
    past[:, :2] = 0
    assert (player(1.0).probabilities(states) == player(1.0).probabilities(dataclasses.replace(states, history=past))).all()


def test_shifts_of_areas_leave_shot_type_and_technique_as_they_are() -> None:
    arrays = shifts(1.0)
    for array in arrays.values():
        array[..., :N_STYLES] = 0
    states = some_states()
    moved, base = HistoryPolicy.of(UNIFORM, arrays).probabilities(states), UNIFORM.probabilities(states)
    assert np.allclose(moved @ OF_STYLE, base @ OF_STYLE, rtol=0, atol=1e-9)
    assert np.abs(moved - base).max() > 0.2


def by_stage() -> tuple[HistoryPolicy, dict[str, np.ndarray]]:
    """A player who remembers no stroke, and the shifts by number and score."""
    arrays = {name: array * (name in STAGES) for name, array in shifts(1.0).items()}
    return HistoryPolicy.of(UNIFORM, arrays), arrays


def styles_of(policy: HistoryPolicy, number: int | None = None, score: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """``[500, 39]`` probabilities of shot types and techniques at one number of the stroke and one score."""
    states = some_states()
    numbers = None if number is None else np.full(len(states), number, np.int32)
    scores = None if score is None else np.tile(np.array(score, np.int16), (len(states), 1))
    return checked_probabilities(policy, dataclasses.replace(states, number=numbers, score=scores)) @ OF_STYLE


def shifted(shift: np.ndarray) -> np.ndarray:
    """``[500, 39]`` what uniform players choose, with shifts of the log-probabilities."""
    p = UNIFORM.probabilities(some_states()) @ OF_STYLE * np.exp(shift[:N_STYLES].astype(float))
    return p / p.sum(axis=1, keepdims=True)


def test_strokes_19_and_27_begin_long_rallies() -> None:
    policy, arrays = by_stage()
    none, (first, second) = np.zeros(N_STYLES), arrays["length"]
    for number, shift in ((None, none), (1, none), (18, none), (19, first), (26, first), (27, second), (99, second)):
        assert np.allclose(styles_of(policy, number), shifted(shift), rtol=0, atol=1e-9)


def test_close_games_end_from_19_points_each() -> None:
    policy, arrays = by_stage()
    for points, ends in (((19, 18), False), ((18, 25), False), ((19, 19), True), ((20, 19), True), ((29, 29), True)):
        shift = arrays["end"][0] * ends
        assert np.allclose(styles_of(policy, score=(*points, 1, 0)), shifted(shift), rtol=0, atol=1e-9)
        both = shift.astype(float) + arrays["length"][0]
        assert np.allclose(styles_of(policy, 20, (*points, 0, 0)), shifted(both), rtol=0, atol=1e-9)


def test_simulated_matches_are_those_of_the_table_without_shifts_and_the_same_each_time_with_them() -> None:
    table = simulate(GAME, dict.fromkeys(NAMES, UNIFORM), matches=1, seed=3)
    assert simulate(GAME, dict.fromkeys(NAMES, player()), matches=1, seed=3) == table
    once, again = (simulate(GAME, {NAMES[0]: player(1.0), NAMES[1]: UNIFORM}, matches=1, seed=3) for _ in range(2))
    assert once == again != table


class Witness:
    """Uniform, and notes the rallies that it is shown."""

    reads_history = True

    def __init__(self) -> None:
        self.seen: list[list[int]] = []

    def probabilities(self, states: States) -> np.ndarray:
        self.seen += np.column_stack([states.history, states.number]).tolist()
        return UniformPolicy().probabilities(states)


def shown_in(rallies: Iterable[list[int]]) -> list[list[int]]:
    """What a player of both seats is shown in rallies: the last strokes, and the number of their own."""
    return [[*([GAME.n_strokes] * 4 + rally[:i])[-4:][::-1], i + 1] for rally in rallies for i in range(len(rally))]


def test_simulated_matches_show_the_last_strokes_of_the_rally() -> None:
    witness = Witness()
    rallies = simulated_rallies(GAME, dict.fromkeys(NAMES, witness), matches=1, seed=0)
    assert witness.seen == shown_in(part.tolist() for part in np.split(rallies.stroke.astype(int), rallies.first_stroke[1:-1]))


def test_the_live_court_shows_them() -> None:
    witness = Witness()
    for number in range(5):
        rally = play_rally(GAME, (witness, witness), stream(1, 0, number), (number, NAMES, Score(server=0)), {})
        assert witness.seen == shown_in([rally.stroke.tolist()])
        witness.seen.clear()


def test_gymnasium_opponents_are_shown_them() -> None:
    class Opponent(Witness):
        def probabilities(self, states: States) -> np.ndarray:
            self.seen.append(env.raw.strokes)
            assert states.history.tolist() == [([GAME.n_strokes] * 4 + env.raw.strokes)[-4:][::-1]]
            assert (states.number.tolist(), states.score) == ([len(env.raw.strokes) + 1], None)
            return UniformPolicy().probabilities(states)

    opponent = Opponent()
    env = SingleRallyEnv(opponent=opponent, game=GAME)
    observation, _ = env.reset(seed=1)
    for _ in range(60):
        observation, _, over, _, _ = env.step(int(np.flatnonzero(observation["action_mask"])[0]))
        if over:
            observation, _ = env.reset()
    assert max(map(len, opponent.seen)) > 2


def test_rallies_without_a_score_have_such_opponents() -> None:
    env = SingleRallyEnv(opponent=by_stage()[0], game=GAME)
    observation, _ = env.reset(seed=1)
    for _ in range(200):
        observation, _, over, _, _ = env.step(int(np.flatnonzero(observation["action_mask"])[0]))
        if over:
            observation, _ = env.reset()


@pytest.mark.parametrize("remembering", [player(), TemperedPolicy(player(), 0.5), Witness()])
def test_what_knows_only_the_state_refuses(remembering) -> None:
    said = "reads the strokes of the rally so far, so it has no table.* use a policy of the state here, such as bc"
    with pytest.raises(HistoryError, match=said):
        tabulate(remembering, GAME)
    with pytest.raises(HistoryError, match=said):
        act(remembering, GAME, observations(GAME, np.array([0]))[0], None, np.random.default_rng(0))


def test_a_player_with_a_memory_is_recovered_from_matches() -> None:
    """They avoid the shot type of their stroke before the last, and like the area of the opponent's."""
    truth = shifts()
    styles = np.arange(N_STYLES) // N_TECHNIQUES
    for shot in range(N_SHOTS):
        truth["shot"][1, shot, :N_STYLES][styles == shot] = -1.5
    truth["area"][0, :9, N_STYLES:] += np.eye(9)
    remembering = HistoryPolicy.of(UNIFORM, truth)
    matches = simulate(GAME, dict.fromkeys(NAMES, remembering), matches=24, seed=0)
    rows = rows_from_strokes(matches)
    half = [rows.matches[i] for i in range(0, 24, 2)]
    others = rows.in_matches([name for name in rows.matches if name not in half])
    networks: dict[str, Any] = {name: Known(name) for name in ("choice", "target")}
    found, scores = fit_history(networks, rows.in_matches(half), others, folds=2)
    assert all(score["cross_entropy"] < score["of_average"] - 0.01 for score in scores.values())
    rallies = simulated_rallies(GAME, dict.fromkeys(NAMES, remembering), matches=10, seed=1)
    strokes = rallies.stroke.astype(int)
    shown = shown_in(part.tolist() for part in np.split(strokes, rallies.first_stroke[1:-1]))
    states = States(game=GAME, state=rallies.states(GAME), history=np.array(shown, np.int32)[:, :4])
    of_truth, of_found, of_base = (
        -np.log(policy.probabilities(states)[np.arange(len(strokes)), strokes]).mean()
        for policy in (remembering, HistoryPolicy.of(UNIFORM, found), UNIFORM)
    )
    assert of_truth < of_found < of_truth + 0.4 * (of_base - of_truth)


class Three:
    """Two copies of a network that knows three equally likely shot types or areas."""

    def __init__(self, name: str) -> None:
        self.size = N_STYLES if name == "choice" else 9

    def logits(self, codes: dict[str, np.ndarray]) -> np.ndarray:
        return np.tile(np.where(np.arange(self.size) < 3, 0.0, -20.0), (2, len(codes["shot"]), 1))


def test_points_of_rows_are_those_before_the_rally() -> None:
    players = dict.fromkeys(NAMES, UNIFORM)
    table = simulate(GAME, players, matches=1, seed=3)
    rallies = simulated_rallies(GAME, players, matches=1, seed=3)
    rally, seat = rallies.row_of_stroke, rallies.striker
    score = np.stack([rallies.score[rally, seat], rallies.score[rally, 1 - seat]], axis=1)
    assert rows_from_strokes(table).points.tolist() == score.tolist()
    ended = table["outcome"].to_numpy() != Outcome.RETURNED
    unknown = table.filter(pa.array(~ended))  # nothing says who won
    assert (rows_from_strokes(unknown).points == -1).all()


def test_choices_by_number_and_score_are_recovered() -> None:
    rng, n = np.random.default_rng(0), 12_000
    number, points = rng.integers(3, 42, n), rng.integers(16, 22, (n, 2))
    long, very_long, close = (number >= 19) & (number <= 26), number >= 27, (points >= 19).all(axis=1)
    shift = 1.0 * long - 1.0 * very_long + 0.5 * close
    odds = np.exp(np.stack([shift, 0 * shift, 0 * shift], axis=1))
    drawn = (rng.random((n, 1)) > np.cumsum(odds / odds.sum(axis=1, keepdims=True), axis=1)).sum(axis=1).astype(np.int16)
    codes = {"technique": drawn, "area": drawn}
    rows = plain_rows(n, codes=codes, stroke=number.astype(np.int16), points=points.astype(np.int8), match=np.arange(n) % 2)
    networks: dict[str, Any] = {name: Three(name) for name in ("choice", "target")}
    found, _ = fit_history(networks, rows, None, folds=2)
    for first in (0, N_STYLES):
        by_length, by_end = (found[name][:, first : first + 3].astype(float) for name in STAGES)
        assert by_length[:, 0] - by_length[:, 1] == pytest.approx([1.0, -1.0], abs=0.15)
        assert by_end[:, 0] - by_end[:, 1] == pytest.approx([0.5], abs=0.15)
        assert np.abs(by_length[:, 1] - by_length[:, 2]).max() < 0.15


@dataclasses.dataclass
class Known:
    """Two copies of a network that knows what uniform players choose."""

    name: str

    def logits(self, codes: dict[str, np.ndarray]) -> np.ndarray:
        catalogue, n = GAME.catalogue, GAME.n_strokes
        parts = [codes[f"incoming_{part}"].astype(int) for part in ("shot", "area", "height", "technique")]
        known = parts[0] < N_SHOTS
        incoming = np.full(len(known), n)
        incoming[known] = catalogue.by_parts[tuple(part[known] for part in parts)]
        p = GAME.reply_mask[incoming, codes["contact"]] / GAME.reply_mask[incoming, codes["contact"]].sum(axis=1, keepdims=True)
        if self.name == "choice":
            p = p @ np.eye(N_STYLES)[catalogue.shot.astype(int) * N_TECHNIQUES + catalogue.technique]
        else:
            p = (p * (catalogue.shot == codes["shot"][:, None]) * (catalogue.technique == codes["technique"][:, None])) @ np.eye(
                9
            )[catalogue.area]
        return np.log(np.maximum(np.stack([p, p]), 1e-12))


def copied(folder: Path, arrays: dict[str, np.ndarray] | None = None) -> Path:
    """A copy of the small model with other choices by the rally so far, or none."""
    shutil.copytree(reduced_model(), folder, dirs_exist_ok=True)
    (folder / HISTORY).unlink(missing_ok=True)
    if arrays is not None:
        (folder / HISTORY).write_bytes(tensor_bytes(arrays, {}))
    write_card(folder, read_model_card(folder))
    return folder


@pytest.fixture(scope="module")
def game(tmp_path_factory: pytest.TempPathFactory) -> Game:
    return load_game(str(copied(tmp_path_factory.mktemp("model"), shifts(0.5))))


def test_the_name_is_listed_and_resolved_where_the_model_has_it(game: Game) -> None:
    assert registry.names(game)[:2] == ("bc", "bc:history")
    assert "memory of the rally" in registry.described_names(game)["bc:history"]
    states = dataclasses.replace(some_states(), game=game)
    policy = registry.resolve_recorded("bc:history", game)
    assert checked_probabilities(policy, states) == pytest.approx(
        HistoryPolicy.of(baselines.load(None, game), shifts(0.5)).probabilities(states)
    )


def test_a_model_without_it_is_named(tmp_path: Path) -> None:
    game = load_game(str(copied(tmp_path)))
    assert baselines.REMEMBERING not in registry.names(game)
    with pytest.raises(PolicyError, match=f"no {HISTORY}; fit the model again, or use bc"):
        registry.resolve("bc:history", game)


def test_tournaments_refuse_it(game: Game) -> None:
    assert baselines.REMEMBERING not in default_pool(game)
    for name in ("bc:history", "bc:history@0.5"):
        with pytest.raises(HistoryError, match=f"{name!r} reads the strokes of the rally so far"):
            enter(name, game)


def test_a_page_of_the_live_court_values_its_strokes_by_bc(game: Game) -> None:
    policies = PolicyTables(game)
    assert policies.table(Side(policy="bc:history")) is policies.table(Side(policy="bc"))


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    folder = copied(tmp_path, {"shot": np.zeros((2, 3, 4), np.float16)})
    with pytest.raises(PolicyError, match=f"{HISTORY}: no readable choices.*fit or install the model again"):
        registry.resolve("bc:history", load_game(str(folder)))
