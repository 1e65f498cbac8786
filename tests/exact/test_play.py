"""Shares of strokes that policies play, counted one by one, and odds under restrictions with their keys."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import known, visits
from shuttle_marl.exact.optimal import restricted_response, restricted_value
from shuttle_marl.exact.play import impossible, play, unusual
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.stroke import FRONT_COURT, SHOTS
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


def test_odds_under_restrictions_are_those_of_the_solvers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    game = hand_made()
    policy, opponent = random_policy(game, 0), random_policy(tiring_game(), 1)
    pairs: Any = [(None, opponent), (random_policy(GAME, 2), opponent), (None, policy), (None, opponent)]
    found = known.restricted_odds(pairs, 0.75, tolerance=1e-6)
    assert found[0] == found[3] == restricted_response(opponent, 0.75, tolerance=1e-6).value.odds()
    assert found[1] == restricted_value(pairs[1][0], opponent, 0.75, tolerance=1e-6).odds()
    assert known.restricted_odds(pairs, 0.75, tolerance=1e-6) == found
    assert known.restricted_odds(pairs[:1], 0.5, tolerance=1e-6) != found[:1]
