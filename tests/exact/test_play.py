"""Shares of strokes that policies play, counted one by one, and odds under restrictions with their keys."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import visits
from shuttle_marl.exact.odds import restricted_odds
from shuttle_marl.exact.optimal import restricted_response, restricted_value
from shuttle_marl.exact.play import impossible, play, unusual
from shuttle_marl.exact.profile import PairPolicy, tabulated_pairs
from shuttle_marl.game.stroke import FRONT_COURT, NET_SHOTS, SHOTS
from shuttle_marl.kernel import play_rallies
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy, tiring_game

GAME = tiring_game()


def test_strokes_that_nobody_can_play() -> None:
    """Strokes of the front court after one to the back, and around the head after one to the forehand side, the right."""
    found, names, came_from = impossible(GAME), GAME.catalogue.names, GAME.incoming(GAME.base_pair_state)
    seen = set()
    for pair in range(0, GAME.n_base_pairs, 5):
        stroke, incoming = int(GAME.base_pair_stroke[pair]), int(came_from[pair])
        came = names[incoming].split(":")[1] if incoming < len(names) else ""
        shot, _, _, technique = names[stroke].split(":")
        front = came.startswith("back") and shot in FRONT_COURT
        around = came.endswith("right") and technique == "around-the-head"
        assert found[pair] == (front or around)
        seen.add((front, around))
    assert len(seen) >= 3


@pytest.mark.parametrize(("each", "rare"), [(0.0045, True), (0.0055, False), (0.3, False)])
def test_shot_types_below_a_percent_are_unusual(each: float, rare: bool) -> None:
    """Two smashes of 0.45 % are less than a percent together, of 0.55 % they are not; one without alternative never is."""
    game = hand_made((*THREE_STROKES, "smash:middle-right:above:forehand", "clear:back-left:above:forehand"))
    names = np.array([name.split(":")[0] for name in game.catalogue.names])[game.base_pair_stroke]
    share = {"smash": each, "clear": 1 - 2 * each}
    probability = np.array([share.get(name, 1.0) for name in names.tolist()])
    (found,) = unusual(PairPolicy(game=game, probability=probability))
    np.testing.assert_array_equal(found, rare & (names == "smash"))


def test_the_play_of_a_policy_is_counted() -> None:
    policy, opponent = random_policy(GAME, 0, 4.0), random_policy(GAME, 1)
    rng = np.random.default_rng(2)
    rare = [rng.random(GAME.n_base_pairs) < 0.3 for _ in range(GAME.n_blocks)]
    found, seen = play(policy, opponent, rare), visits(policy, opponent)
    weight = policy.pair_probabilities() * seen.states[0][GAME.pair_state]
    shot = GAME.catalogue.shot[GAME.pair_stroke]
    mix = np.bincount(shot, weight, len(SHOTS)) / weight.sum()
    assert found["shots"] == pytest.approx(dict(zip(SHOTS, mix.tolist(), strict=True)), abs=1e-9)
    assert found["types"] == sum(share > 0.02 for share in mix)
    assert found["bits"] == pytest.approx(-sum(share * np.log2(share) for share in mix if share > 0), abs=1e-9)
    assert found["length"] == seen.rally_length
    assert found["rare"] == pytest.approx(weight[np.concatenate(rare)].sum() / weight.sum())


def test_play_counted_over_simulated_rallies() -> None:
    """20,000 rallies stroke by stroke; every share is within four standard errors of the exact one."""
    cross = GAME.catalogue.shot[GAME.pair_stroke] == SHOTS.index("cross-court-net-shot")
    policy, opponent = (
        PairPolicy(game=GAME, probability=GAME.normalized(random_policy(GAME, seed).pair_probabilities() * np.where(cross, 5, 1)))
        for seed in (0, 1)
    )
    found = play(policy, opponent, [np.zeros(GAME.n_base_pairs, np.bool_)] * GAME.n_blocks)
    rallies = play_rallies(GAME, (tabulated_pairs(policy), tabulated_pairs(opponent)), 20_000, seed=3)
    shot, _, height, _ = np.array([name.split(":") for name in GAME.catalogue.names])[rallies.stroke].T.tolist()
    top: dict[str, Any] = {name: np.zeros(len(rallies)) for name in ("lift", "clear", "smash_after_lift", "net_runs", "served")}
    bottom = {name: count.copy() for name, count in top.items()}
    for rally, (first, last) in enumerate(itertools.pairwise(rallies.first_stroke.tolist())):
        crossed = [name == "cross-court-net-shot" for name in shot[first:last]]
        for i in range(first, last):
            if rallies.striker[i] == 1:
                continue
            before = shot[i - 1] if i > first else ""
            windows = (crossed[k : k + 3] for k in range(max(0, i - first - 2), i - first + 1))
            counted = {
                "lift": (True, shot[i] == "lift"),
                "clear": (True, shot[i] == "clear"),
                "smash_after_lift": (before == "lift" and height[i] == "above", shot[i] == "smash"),
                "net_runs": (shot[i] in NET_SHOTS, any(window == [True] * 3 for window in windows)),
                "served": (before == "short-serve", shot[i] == "cross-court-net-shot"),
            }
            for name, (asked, answered) in counted.items():
                bottom[name][rally] += asked
                top[name][rally] += asked and answered
    exact = {**found, **found["shots"], "served": found["short_serve_replies"]["cross-court-net-shot"]}
    for name, asked in bottom.items():
        share = top[name].sum() / asked.sum()
        error = np.sqrt(((top[name] - share * asked) ** 2).sum()) / asked.sum()
        assert exact[name] == pytest.approx(share, abs=4 * error)
        assert error < 0.01
    assert exact["net_runs"] > 0.05


def test_odds_under_restrictions_are_those_of_the_solvers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    game = hand_made()
    policy, opponent = random_policy(game, 0), random_policy(tiring_game(), 1)
    pairs: Any = [(None, opponent), (random_policy(GAME, 2), opponent), (None, policy), (None, opponent)]
    found = restricted_odds(pairs, 0.75, tolerance=1e-6)
    assert found[0] == found[3] == restricted_response(opponent, 0.75, tolerance=1e-6).value.odds()
    assert found[1] == restricted_value(pairs[1][0], opponent, 0.75, tolerance=1e-6).odds()
    assert restricted_odds(pairs, 0.75, tolerance=1e-6) == found
    assert restricted_odds(pairs[:1], 0.5, tolerance=1e-6) != found[:1]
