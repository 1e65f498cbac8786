"""Shares of strokes that policies play, counted one by one, and odds under restrictions with their keys."""

import itertools
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import known, visits
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.optimal import restricted_response, restricted_value
from shuttle_marl.exact.play import impossible, play, unusual
from shuttle_marl.exact.profile import PairPolicy, tabulated_pairs
from shuttle_marl.game.stroke import FRONT_COURT, NET_SHOTS, SHOTS
from shuttle_marl.kernel import play_rallies
from shuttle_marl.policy import scorecard
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


def test_odds_under_restrictions_are_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: dict[bytes, bytes] = {}

    class Cache:
        def read(self, keys: Any) -> dict[bytes, bytes]:
            return {key: kept[key] for key in keys if key in kept}

        def store(self, found: dict[bytes, bytes]) -> None:
            kept.update(found)

    monkeypatch.setattr(known, "_CACHE", Cache())
    game = hand_made()
    policy, opponent = random_policy(game, 0), random_policy(tiring_game(), 1)
    pairs: Any = [(None, opponent), (random_policy(GAME, 2), opponent), (None, policy), (None, opponent)]
    found = known.restricted_odds(pairs, 0.75, tolerance=1e-6)
    assert len(kept) == 3
    assert found[0] == found[3] == restricted_response(opponent, 0.75, tolerance=1e-6).value.odds()
    assert found[1] == restricted_value(pairs[1][0], opponent, 0.75, tolerance=1e-6).odds()

    def again(*_: Any, **__: Any) -> Any:
        raise ArithmeticError("solved again")

    monkeypatch.setattr(known, "restricted_response", again)
    monkeypatch.setattr(known, "restricted_value", again)
    assert known.restricted_odds(pairs, 0.75, tolerance=1e-6) == found
    for p, tolerance in ((0.5, 1e-6), (0.75, 1e-7)):
        with pytest.raises(ArithmeticError, match="solved again"):
            known.restricted_odds(pairs[:1], p, tolerance=tolerance)
    assert known._swapped(Odds(serving=0.3, receiving=0.6, error_bound=0.1)) == Odds(serving=0.4, receiving=0.7, error_bound=0.1)


def test_the_depth_of_a_game_from_what_its_policies_play(monkeypatch: pytest.MonkeyPatch) -> None:
    """bc wins half, the best response .75, and two lists of each class .6 and .55; perfect play beats them with .7 and .65."""
    game = GAME
    bc, perfect, first, second, mean = ("bc", "perfect", "first", "second", "mean")
    rally = {("first", "bc"): 0.6, ("second", "bc"): 0.55, ("mean", "bc"): 0.5}
    rally |= {("first", "perfect"): 0.3, ("second", "perfect"): 0.35, ("mean", "perfect"): 0.2}
    gain = {"bc": 0.5, "first": 0.3, "second": 0.2, "mean": 0.4}

    class Found:
        def __init__(self, value: float, policy: Any = None) -> None:
            self.value, self.rally, self.policy = self if policy is None else value, value, policy

        def odds(self) -> Any:
            return Odds(serving=self.rally, receiving=self.rally, error_bound=0.0)

    class Answer:
        def __init__(self, name: Any) -> None:
            rally = (1 + gain[name]) / 2
            self.value = Found(rally)

    class Solved:
        policy = (type("Perfect", (str,), {"waits": None})(perfect),)

    reported: list[str] = []
    monkeypatch.setattr(scorecard, "tabulate", lambda policy, _: policy)
    monkeypatch.setattr(scorecard, "resolve", lambda name, _: name)
    monkeypatch.setattr(scorecard, "unusual", lambda policy: ["rare", policy])
    monkeypatch.setattr(scorecard, "play", lambda *players: {"played": players})
    monkeypatch.setattr(scorecard, "solve", lambda _: Solved())
    monkeypatch.setattr(scorecard, "best_response", Answer)
    monkeypatch.setattr(scorecard, "cells_of", lambda _, *parts: parts)
    monkeypatch.setattr(scorecard, "lists", lambda against, cell, waits: [first] if against == bc else [second])
    monkeypatch.setattr(scorecard, "averaged", lambda *_: mean)
    monkeypatch.setattr(scorecard, "evaluate", lambda one, other: Found(rally[one, str(other)]))
    found = scorecard.depth(game, ("bc", "safe"), report=reported.append)
    assert found["policies"] == {
        "bc": {"self": {"played": ("bc", "bc", ["rare", "bc"])}, "bc": {"played": ("bc", "bc", ["rare", "bc"])}},
        "safe": {"self": {"played": ("safe", "safe", ["rare", "bc"])}, "bc": {"played": ("safe", "bc", ["rare", "bc"])}},
    }
    assert set(found["lists"]) == {"nothing", "incoming_shot", "incoming_stroke", "no_own", "no_hurried"}
    for each in found["lists"].values():
        assert each == pytest.approx({"score": 0.1 / 0.25, "exploitability": 0.2, "against_minimax": 0.35})
    assert found["impossible"] == int(impossible(game).sum()) * 9
    assert (found["game"], set(found)) == (game.hash, {"game", "impossible", "policies", "people", "lists"})
    assert found["people"] is None
    assert reported[:3] == ["bc", "safe", "lists that read nothing"]
    assert "lists that read incoming shot" in reported
    assert scorecard.LISTS["no_own"] == ("incoming", "contact", "duel", "effort", "opponent_effort", "hurried")
    assert scorecard.LISTS["no_hurried"] == ("own", "incoming", "contact", "duel", "effort", "opponent_effort")
