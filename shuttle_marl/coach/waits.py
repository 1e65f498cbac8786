"""Where players wait: the section of both reports."""

from collections.abc import Iterator, Sequence

import numpy as np

from shuttle_marl.analysis.waits import LEAST_METRES, Place, Wait
from shuttle_marl.coach import charts
from shuttle_marl.coach.blocks import Block, Section, shown, text
from shuttle_marl.coach.words import of_100, words
from shuttle_marl.game.court import N_SIDES
from shuttle_marl.game.recovery import ACROSS, DEPTHS
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.pages import Cell, Column, name, table


def waiting(found: Sequence[Wait], players: Sequence[str], hands: Sequence[str | None], *, match: bool = False) -> list[Section]:
    """The section; none without known positions. ``match``: the players are each other's only opponents."""
    if not found:
        return []
    say = words()
    first = {wait.shot for wait in found if wait.player == 0}
    # Between two players a difference is the same from both sides.
    told = [(wait, *named) for wait in found if not (match and wait.player and wait.shot in first) for named in _named(wait)]
    told.sort(key=lambda each: -abs(each[2].difference.value))
    lines = []
    for wait, key, place in told:
        value, low, high = map(_metres, (place.difference.value, *sorted(map(abs, place.difference[1:]))))
        others = players[1 - wait.player] if match else say("waits.others")
        fields = {"metres": value, "low": low, "high": high, "strokes": wait.strokes, "others": others}
        lines.append(say(f"waits.{key}", player=players[wait.player], shots=say.shots(wait.shot), **fields))
    columns: list[Column[Wait]] = [
        Column(say("waits.player"), lambda w: name(players[w.player]), left=True),
        Column(say("waits.after"), lambda w: name(say.shots(w.shot)), left=True),
        Column(say("waits.strokes"), lambda w: Cell(say.number(w.strokes, ","), w.strokes)),
        Column(say("waits.distance"), lambda w: Cell(_distance(w.depth), w.depth.mean.value)),
        Column(say("waits.depth"), lambda w: name(_shares(w, 1))),
        Column(say("waits.side"), lambda w: name(_shares(w, 0))),
        Column(say("waits.shown"), lambda w: name(_shown(w)), left=True, wrap=True),
    ]
    drawn = []
    for player, who in enumerate(players):
        courts = [(say.shots(wait.shot), wait.positions) for wait in found if wait.player == player]
        if courts:
            fields = {"player": say.hands([(who, hands[player])]), "sides": say(f"sides.behind_{hands[player] or 'right'}")}
            caption = say("waits.chart", **fields)
            drawn.append((charts.waits(courts, caption, hands[player]), caption))
    metres = {"front": _metres(DEPTHS[0], 1), "back": _metres(DEPTHS[1], 1), "centre": _metres(ACROSS)}
    basis = say("waits.basis", least=RELIABLE, metres=_metres(LEAST_METRES, 1))
    about = [text(say("waits.about", **metres)), text(basis)]
    rest = [Block("list", items=lines[1:])] if lines[1:] else []
    blocks = [*rest, Block("courts", items=drawn), shown(table(found, columns)), *about]
    return [Section(say("waits.heading"), lines[0] if lines else say("waits.none"), blocks)]


def _named(wait: Wait) -> Iterator[tuple[str, Place]]:
    """Differences that the data support, with their words."""
    for place, keys in ((wait.depth, ("closer", "farther")), (wait.side, ("backhand", "forehand"))):
        if place.clear:
            yield keys[place.difference.value > 0], place


def _shown(wait: Wait) -> str:
    say = words()
    parts = [say(f"waits.shown_{key}", metres=_metres(place.difference.value)) for key, place in _named(wait)]
    return say.listed(parts) or say("waits.same")


def _distance(place: Place) -> str:
    value, low, high = (_metres(part) for part in place.mean)
    return value if np.isnan(place.mean.low) else words()("report.interval", value=value, low=low, high=high)


def _shares(wait: Wait, axis: int) -> str:
    """Shares by depth (``axis`` 1) or by side (0)."""
    return " / ".join(of_100(share) for share in np.reshape(wait.positions, (-1, N_SIDES)).sum(axis=axis).tolist())


def _metres(value: float, digits: int = 2) -> str:
    return words().number(abs(value), f".{digits}f")
