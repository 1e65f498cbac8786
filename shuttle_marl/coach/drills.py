"""Drills for the week, each with a drawing of the court."""

from collections.abc import Iterable
from typing import Final

from shuttle_marl.analysis.pictures import of_hand
from shuttle_marl.coach import charts
from shuttle_marl.coach.blocks import Block, Section
from shuttle_marl.coach.words import words
from shuttle_marl.game.stroke import SHOTS, Catalogue

DRILLS: Final = 3


def training(
    catalogue: Catalogue, asked: Iterable[tuple[int, int, int]], lead: str, hands: tuple[str | None, str | None]
) -> Section:
    """Three drills of different kinds, the first ones where there are more.

    Args:
        asked: shot type of the incoming stroke, area where the player meets it, and catalogue index of the stroke to play; -1 and
            -1 for the serve.
        hands: of the player and of the opponent; None: unknown.
    """
    say, chosen = words(), list(asked)
    kinds = [(shot, int(catalogue.shot[stroke])) for shot, _, stroke in chosen]
    first = [i for i, kind in enumerate(kinds) if kind not in kinds[:i]]
    drawn = []
    for number, i in enumerate(sorted(range(len(chosen)), key=lambda i: (i not in first, i))[:DRILLS], start=1):
        shot, area, stroke = chosen[i]
        target = say.stroke(catalogue, stroke, "their", met=area, hands=hands)
        if shot < 0:
            caption = say("drills.serve", number=number, stroke=target)
        else:
            caption = say("drills.feed", number=number, shot=say.shot(SHOTS[shot]), area=say.area(area, "your"), stroke=target)
        places = of_hand(area, hands[0]), of_hand(int(catalogue.area[stroke]), hands[1])
        drawn.append((charts.drill(*places, caption), caption))
    return Section(say("drills.title"), lead, [Block("courts", items=drawn)])
