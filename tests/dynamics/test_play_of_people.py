"""What people play, counted by hand, and its place in the card of the shipped model."""

import numpy as np
import pytest

from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.play import play_of_people
from shuttle_marl.game.shipped import default_game, load_game, real_play
from shuttle_marl.game.stroke import SHOTS
from tests.dynamics.rows import plain_rows

PLAYED = (  # match, stroke, shot type, area, height, outcome
    (0, 1, "short-serve", 1, 0, Outcome.RETURNED),
    (0, 2, "cross-court-net-shot", 0, 0, Outcome.RETURNED),
    (0, 3, "cross-court-net-shot", 2, 0, Outcome.RETURNED),
    (0, 4, "cross-court-net-shot", 0, 1, Outcome.RETURNED),
    (0, 5, "lift", 7, 0, Outcome.RETURNED),
    (0, 6, "smash", 5, 1, Outcome.WINNER),
    (0, 1, "short-serve", 1, 0, Outcome.RETURNED),
    (0, 2, "lift", 6, 0, Outcome.RETURNED),
    (0, 3, "clear", 8, 1, Outcome.FAULT),
    (0, 1, "short-serve", 1, 0, Outcome.RETURNED),
    (0, 2, "net-shot", 1, 0, Outcome.RETURNED),
    (0, 3, "cross-court-net-shot", 2, 0, Outcome.RETURNED),
    (0, 4, "cross-court-net-shot", 2, 0, Outcome.RETURNED),
    (0, 6, "cross-court-net-shot", 2, 0, Outcome.RETURNED),  # a row was dropped
    (1, 7, "cross-court-net-shot", 2, 0, Outcome.UNKNOWN),
)


def test_play_of_people_in_three_rallies() -> None:
    match, stroke, shot, area, height, outcome = zip(*PLAYED, strict=True)
    code = [SHOTS.index(name) for name in shot]
    incoming = [13 if number == 1 else before for number, before in zip(stroke, [13, *code[:-1]], strict=True)]
    codes = {
        name: np.array(values, np.int16)
        for name, values in {"shot": code, "area": area, "contact": height, "incoming_shot": incoming}.items()
    }
    rows = plain_rows(
        len(PLAYED),
        codes=codes,
        match=np.array(match, np.int32),
        stroke=np.array(stroke, np.int16),
        outcome=np.array(outcome, np.int8),
    )
    found = play_of_people(rows)
    assert found["shots"]["cross-court-net-shot"] == pytest.approx(7 / 15)
    assert found["types"] == 6
    assert found["kinds"] == 7  # not the clear, a fault, whose target is not known
    assert found["smash_after_lift"] == 0.5
    assert {name: share for name, share in found["short_serve_replies"].items() if share} == pytest.approx(
        {"cross-court-net-shot": 1 / 3, "lift": 1 / 3, "net-shot": 1 / 3}
    )
    assert found["net_runs"] == 3 / 8
    assert found["length"] == 4.5
    assert play_of_people(rows.none())["length"] == 0


def test_shipped_card_has_play_of_people() -> None:
    people = real_play(default_game())
    assert people is not None
    assert set(people) == set(play_of_people(plain_rows(1)))
    for mix in (people["shots"], people["short_serve_replies"]):
        assert (set(mix), sum(mix.values())) == (set(SHOTS), pytest.approx(1))
    assert real_play(load_game("default:recovery")) == people
    assert real_play(load_game("default:women")) is None
