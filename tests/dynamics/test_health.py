"""The health check: the figures of the model card again, and statistics of play against simulation."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from shuttle_marl.dynamics.evaluate import health
from shuttle_marl.dynamics.make import load_support
from shuttle_marl.exact import PairPolicy
from shuttle_marl.game.shipped import BC, CHOICE_UNITS, default_game, model_folder, read_model
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import base_pairs, layout, thresholds

NAMES = (
    "short-serve:front-centre:below:backhand",
    "clear:back-centre:above:forehand",
    "smash:middle-left:above:forehand",
    "lift:back-centre:below:forehand",
)


def small() -> Game:
    """Serve, then only clears and smashes from above, lifts from below."""
    catalogue = Catalogue.from_names(NAMES)
    replies = np.array([[0, 1, 1, 1]] * 4 + [[1, 0, 0, 0]], dtype=bool)
    tables = layout(catalogue, replies)
    pairs = base_pairs(tables)
    hurry = np.zeros((pairs, 2), np.uint8)
    game = Game(catalogue=catalogue, threshold=np.zeros((pairs, 3), np.uint16), hurry=hurry, **tables)
    good = np.array([1.0, 0.9375, 0.75, 0.875])[game.pair_stroke]
    returned = np.array([1.0, 1.0, 0.5, 1.0])[game.pair_stroke]
    above = np.array([0.5, 1.0, 0.0, 1.0])[game.pair_stroke]
    return Game(catalogue=catalogue, threshold=thresholds(good, returned, above), hurry=hurry, **tables)


def flat(figures: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in figures.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def test_the_figures_of_the_model_card_are_those_of_the_solvers() -> None:
    """Plain value iteration made them, when the model was fitted; the probabilities of BC are not rounded there."""
    game = default_game()
    weight = np.tile(np.exp(read_model(model_folder(), BC).arrays["choice"] / CHOICE_UNITS), game.n_blocks)
    card = json.loads((model_folder() / "card.json").read_text(encoding="utf-8"))
    strokes = load_support(model_folder()).strokes
    found = dict(flat(health(PairPolicy(game=game, probability=game.normalized(weight)), strokes)))
    of_refits = card["health"].pop("refits")
    assert of_refits.keys() == {"largest_shot_share", "shot_types_above_2_percent"}
    expected = dict(flat(card["health"]))
    numbers = {key for key, value in found.items() if isinstance(value, float)}
    assert {key: found[key] for key in numbers} == pytest.approx({key: expected[key] for key in numbers}, abs=2e-9)
    assert {key: found[key] for key in found.keys() - numbers} == {key: expected[key] for key in expected.keys() - numbers}


def test_a_figure_outside_of_its_limits_is_a_warning() -> None:
    """Hardly a stroke of the small game is real, and it has three shot types for the rally."""
    game = small()
    policy = PairPolicy(game=game, probability=game.normalized(np.ones(game.n_pairs)))

    def of(strokes: float) -> dict[str, Any]:
        return health(policy, np.full(len(game.edge_own), strokes))

    def warned(figures: dict[str, Any], what: str) -> list[str]:
        return [warning.partition(":")[0] for warning in figures["warnings"] if what in warning]

    everything, nothing = (dict.fromkeys(("bc", "best_response", "minimax"), share) for share in (1.0, 0.0))
    without, few, enough = of(0.0), of(4.5), of(5.0)
    assert (without["unsupported"], without["thin"]) == (everything, everything)
    assert (few["unsupported"], few["thin"]) == (nothing, everything)
    assert (enough["unsupported"], enough["thin"]) == (nothing, nothing)
    assert warned(without, "unsupported") == ["minimax unsupported", "best response unsupported"]
    assert warned(without, "thin") == warned(few, "thin") == ["minimax thin", "best response thin"]
    assert warned(few, "unsupported") == warned(enough, "thin") == []
    assert "shot types above 2 percent: 3, expected 7 to 13" in enough["warnings"]
    assert not any("wins" in warning for warning in enough["warnings"]), "what wins is no matter of health"
