"""A rally of the shipped game in words and numbers, as a person can check it with ``docs/concepts.md`` at hand.

Digests say that something changed; this says what. After a wanted change of the game, ``python -m tests.game.test_golden_rally``
writes the file again.
"""

import itertools
from pathlib import Path

import numpy as np

from shuttle_marl.game import default_game, tabulate
from shuttle_marl.game.rally import RallyDraws, choose, stepper_of
from shuttle_marl.game.rules import OUTCOMES, RETURNED_BELOW
from shuttle_marl.game.tables import ROOT
from shuttle_marl.policy import resolve

GOLDEN = Path(__file__).with_name("golden_rally.txt")
RALLY = 8


def described() -> str:
    """A rally between two average players: every state, stroke, probability and outcome."""
    game = default_game()
    bc = tabulate(resolve("bc", game), game)
    stepper, draws = stepper_of(game), RallyDraws(0)
    state, player = ROOT, draws.first_server(RALLY)
    lines = [f"game {game.hash[:12]}, seed 0, rally {RALLY}, bc against bc"]
    for i in itertools.count():
        pairs = game.pairs_of(state)
        stroke = choose(bc, game, state, draws.choice(RALLY, i))
        pair = np.array([game.pair(state, stroke)])
        (good,), (returned,), (above,) = game.stroke_probabilities(pair)
        below_hurried, above_hurried = game.hurry_of(pair)[0]
        played, following = stepper.step(state, player, stroke, draws.outcome(RALLY, i))
        lines += [
            "",
            f"stroke {i + 1}, player_{player}, state {state}, {pairs.stop - pairs.start} legal strokes",
            f"  {game.catalogue.names[stroke]}, chosen with {bc.probability_of(pair)[0]:.4f}",
            f"  good {good:.4f}; if good, returned {returned:.4f}; if returned, met above the net {above:.4f}",
            f"  receiver hurried: below {below_hurried:.4f}, above {above_hurried:.4f}",
            f"  -> {OUTCOMES[played.outcome]}",
        ]
        if played.outcome < RETURNED_BELOW:
            return "\n".join(lines) + "\n"
        state, player = following, 1 - player
    raise AssertionError


def test_the_rally_is_the_written_one() -> None:
    assert described() == GOLDEN.read_text(encoding="utf-8")


if __name__ == "__main__":
    GOLDEN.write_text(described(), encoding="utf-8")
