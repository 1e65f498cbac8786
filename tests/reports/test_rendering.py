"""Parts that both reports share: names, drills, differences with their sizes, and packed examples."""

import math

import numpy as np
import pytest

from shuttle_marl.game.shipped import Estimate
from shuttle_marl.reports.rendering import Drill, differences, drills
from shuttle_marl.reports.waits import Place, Wait
from shuttle_marl.reports.words import Words
from shuttle_marl.watch.clips import base91

WIDE = Estimate(0.5, 0.375, 0.625)


def test_names_of_players_and_events() -> None:
    say = Words("en")
    assert [say.player(name) for name in ("viktor-axelsen", "club", "Ada-Bo", "a-1", "li-na")] == [
        *("Viktor Axelsen", "club", "Ada-Bo", "a-1", "Li Na")
    ]
    assert say.event("Viktor_AXELSEN_Kento_MOMOTA_Open_2020_Final", ("viktor-axelsen", "kento-momota")) == "Open 2020 Final"
    assert (say.capital("a smash"), say.capital("")) == ("A smash", "")
    assert [say.shot("smash", form) for form in (0, 1, 2, 9)] == ["smash", "a smash", "smashes", "smashes"]


def test_drills_are_the_first_three_of_different_kinds() -> None:
    asked = [Drill("lift", 1, stroke, kind) for stroke, kind in ((1, 5), (2, 5), (3, 6), (4, 7), (5, 7), (6, 8), (7, 5))]
    assert [drill.stroke for drill in drills(asked)] == [1, 3, 4]
    assert drills(asked[:2]) == asked[:1]
    assert drills([]) == []


def test_a_difference_of_a_match_is_said_of_one_player() -> None:
    """That of the other one is the same; of two players of different matches both are said."""

    def wait(player: int, shot: str) -> Wait:
        depth, side = (Place(mean=each, difference=each, p=0.01, clear=True) for each in (Estimate(-0.25, -0.4, -0.125), WIDE))
        return Wait(player=player, shot=shot, strokes=50, others=60, positions=(1.0,) + 8 * (0.0,), depth=depth, side=side)

    found = [wait(0, "smash"), wait(1, "smash"), wait(1, "lift")]
    said = [(each.wait.player, each.wait.shot, each.kind, each.value) for each in differences(found, match=True)]
    assert said == [
        (0, "smash", "forehand", 0.5),
        (1, "lift", "forehand", 0.5),
        (0, "smash", "closer", 0.25),
        (1, "lift", "closer", 0.25),
    ]
    assert len(differences(found, match=False)) == 6


def decoded(text: str) -> bytes:
    """The content of basE91 text, as its description says: two letters are 13 bits, or 14 if these would be below 89."""
    letters = [chr(code) for code in range(33, 127) if chr(code) not in '"\\<']
    bits = ""
    for i in range(0, len(text), 2):
        pair = [letters.index(letter) for letter in text[i : i + 2]]
        value = pair[0] + 91 * pair[1] if len(pair) == 2 else pair[0]
        size = (13 if value & 8191 > 88 else 14) if len(pair) == 2 and i + 2 < len(text) else 16
        bits = f"{value:0{size}b}"[-size:] + bits
    size = len(bits) % 8
    whole = int(bits, 2).to_bytes(len(bits) // 8 + bool(size), "little")
    return whole


@pytest.mark.parametrize("size", [1, 2, 3, 12, 13, 14, 15, 200])
def test_packed_content_is_unpacked_to_the_same(size: int) -> None:
    rng = np.random.default_rng(size)
    contents = (bytes(size), b"\xff" * size, b"\x58" * size, *(rng.integers(0, 256, size, np.uint8).tobytes() for _ in range(20)))
    for content in contents:
        text = base91(content)
        assert not set(text) & set('"\\< \n')
        assert decoded(text)[:size] == content
        assert not any(decoded(text)[size:])
        assert len(text) <= math.ceil(16 * size / 13) + 1
    assert base91(b"") == ""
