"""The scripted styles play as their rules say and beat random play; and the depth table of a small game."""

import itertools
import json
from typing import Any

import numpy as np
import pytest

from shuttle_marl.commands import exact
from shuttle_marl.exact import evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS, area_centre
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.policy import States, tabulate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import ROOT
from shuttle_marl.policy import baselines
from shuttle_marl.policy.baselines import STYLES, ScriptedPolicy
from shuttle_marl.policy.registry import resolve
from tests import golden
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
PLAYABLE = np.flatnonzero(GAME.legal_count(np.arange(GAME.n_states))).astype(np.int32)
STATES = States(game=GAME, state=PLAYABLE)
DOWN = [SHOTS.index(name) for name in ("smash", "half-smash", "net-kill")]
HIGH = [SHOTS.index(name) for name in ("clear", "lift", "long-serve")]


def share(name: str, shots: list[int], where: np.ndarray) -> float:
    p = resolve(name, GAME).probabilities(States(game=GAME, state=PLAYABLE[where]))
    return float(p[:, np.isin(GAME.catalogue.shot, shots)].sum(axis=1).mean())


@pytest.mark.parametrize("style", STYLES)
def test_every_style_beats_random_play_in_the_shipped_game(style: str) -> None:
    """Random strokes are among those that people choose there, so they lose little to a style that seldom attacks."""
    game = default_game()
    one, other = (tabulate(resolve(name, game), game) for name in (style, "random"))
    assert evaluate(one, other, tolerance=1e-3).odds().rally > 0.505


def test_a_point_more_is_played_e_times_as_often() -> None:
    points = np.zeros(GAME.n_strokes)
    first, second = GAME.legal_strokes(ROOT)[:2]
    points[first] = 1.0
    p = ScriptedPolicy(lambda states: np.tile(points, (len(states), 1))).probabilities(
        States(game=GAME, state=np.array([ROOT], dtype=np.int32))
    )
    assert p[0, first] / p[0, second] == pytest.approx(np.e)


def test_attackers_hit_down_from_above_and_defenders_lift_from_below() -> None:
    above, below = STATES.contact == 1, (STATES.contact == 0) & (STATES.incoming < GAME.n_strokes)
    assert share("attacking", DOWN, above) > 1.5 * share("random", DOWN, above)
    assert share("attacking", HIGH, below) < share("random", HIGH, below) < share("defensive", HIGH, below)
    serve = PLAYABLE == ROOT
    assert share("attacking", [SHOTS.index("short-serve")], serve) > share("random", [SHOTS.index("short-serve")], serve)


def test_safe_play_faults_least() -> None:
    fault = np.zeros((GAME.n_states, GAME.n_strokes))
    fault[GAME.pair_state, GAME.pair_stroke] = 1 - GAME.stroke_probabilities()[0]
    mean = {n: (resolve(n, GAME).probabilities(STATES) * fault[PLAYABLE]).sum(axis=1).mean() for n in ("random", *STYLES)}
    assert min(mean, key=lambda name: mean[name]) == "safe"


def test_a_target_off_the_centre_line_costs_defenders_a_point() -> None:
    catalogue, compared = GAME.catalogue, 0
    p = ScriptedPolicy(baselines.defensive).probabilities(STATES)
    kind = np.stack([catalogue.shot, catalogue.area // 3, catalogue.height, catalogue.technique])
    for k, j in itertools.permutations(range(GAME.n_strokes), 2):
        both = (p[:, [k, j]] > 0).all(axis=1)
        if both.any() and (kind[:, k] == kind[:, j]).all() and catalogue.area[k] % 3 == 1:
            np.testing.assert_allclose(p[both, k] / p[both, j], np.e)
            compared += both.sum()
    assert compared > 50


def test_points_of_safe_play() -> None:
    """For a percentage point of faults, of returns from above, of winners."""
    row, pair = GAME.pairs(PLAYABLE)
    fault, winner, below = GAME.limits_of(pair).T / ONE
    p = resolve("safe", GAME).probabilities(STATES)[row, GAME.base_pair_stroke[pair % GAME.n_base_pairs]]
    points = 100 * (1 - fault) - 10 * (1 - below) + 5 * (winner - fault)
    first = np.r_[True, row[1:] != row[:-1]]
    of_first = np.maximum.accumulate(np.where(first, np.arange(len(row)), 0))
    np.testing.assert_allclose(np.log(p / p[of_first]), points - points[of_first], atol=1e-6)


def test_the_opponent_stands_where_the_last_stroke_went() -> None:
    distance = baselines.distance_from_opponent(STATES)
    row = int(np.argmax(STATES.own < GAME.n_strokes))
    own = STATES.own[row]
    same_area = GAME.catalogue.area == GAME.catalogue.area[own]
    assert (distance[row, same_area] == 0).all()
    assert (distance[row, ~same_area] > 0).all()
    assert (distance[STATES.own == GAME.n_strokes] == 0).all()
    far = int(np.flatnonzero(GAME.catalogue.area == AREAS.index("back-left"))[0])
    a, b = area_centre(GAME.catalogue.area[[own, far]])
    assert distance[row, far] == pytest.approx(np.hypot(*(a - b)))


@pytest.mark.slow
def test_depth_of_a_small_game(capsys: pytest.CaptureFixture[str]) -> None:
    assert exact.main(["depth", "bc", "minimax", "--game", reduced_model(), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    golden.check("exact", {"depth": found | {"game": None}})
