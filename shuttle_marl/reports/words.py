"""Texts of the reports in the current language, with the words of badminton: strokes, areas, players."""

import functools
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from shuttle_marl.dynamics.habits import DIRECTED, DIRECTIONS, straight
from shuttle_marl.game.court import AREAS, N_SIDES
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue
from shuttle_marl.reports.habits import ENDS, Expected, Habit, Option, Situation, Statement, is_short
from shuttle_marl.reports.languages import Language, Texts, current
from shuttle_marl.reports.waits import Difference

if TYPE_CHECKING:
    from shuttle_marl.reports.match import RallyRow

_CENTRE: Final = 1
AT_BODY: Final = ("smash", "half-smash", "drive", "push", "net-kill")
"""Shot types that are played at the body of the opponent when they go to the middle of the court."""


class Words(Texts):
    """Texts by key, and what they are about in words."""

    def shot(self, shot: str, form: int = 1) -> str:
        """A shot type: ``smash`` (form 0), ``a smash`` (1) or ``smashes`` (2); in a language without such forms the same."""
        return self._form("shots", shot, form)

    def technique(self, technique: str) -> str:
        """A technique, such as ``with the forehand``."""
        return self._form("techniques", technique, 1)

    def _form(self, group: str, name: str, form: int) -> str:
        forms: list[str] = self.groups[group][name]
        return forms[min(form, len(forms) - 1)]

    def shots(self, shot: str) -> str:
        """A shot type in the plural."""
        return self.shot(shot, 2)

    def player(self, name: str) -> str:
        """A player as people write the name: ``Viktor Axelsen`` for ``viktor-axelsen``; names of others stay as they are."""
        if name in self.groups["players"]:
            return str(self.groups["players"][name])
        return name.replace("-", " ").title() if name.islower() and re.fullmatch(r"[^\W\d_]+(-[^\W\d_]+)+", name) else name

    @staticmethod
    def capital(text: str) -> str:
        """A text that begins a sentence."""
        return text[:1].upper() + text[1:]

    def target(self, shot: str, area: int, whose: str, form: int = 2) -> str:
        """A shot type in a form, to an area: ``smashes at the body``; either may be empty or -1, for any."""
        if area < 0:
            return self.shot(shot, form)
        if not shot:
            return self("stroke.place", area=self.area(area, whose))
        if shot in AT_BODY and AREAS[area] == "middle-centre":
            return self("stroke.body", shot=self.shot(shot, form))
        return self._deep(SHOTS.index(shot), area, self("stroke.to", shot=self.shot(shot, form), area=self.area(area, whose)))

    def _deep(self, shot: int, area: int, text: str) -> str:
        """A stroke, which a player hears is short where it is meant for the rear court."""
        return self("stroke.shallow", stroke=text) if is_short(shot, area) else text

    def most(self, found: Expected) -> str:
        """Answers with their shares of 100: ``lifts 36, net shots 32``."""
        own: dict[str, str] = self.groups["directions"] if found.kind in ("serve_side", "direction") else {}
        return self.listed(f"{own[name] if own else self.shots(name)} {of_100(share)}" for name, share in found.most)

    def area(self, area: int, whose: str) -> str:
        """An area, named as a right-handed player at that place sees it, such as ``your front backhand corner``."""
        return self(f"areas.{AREAS[area]}", whose=self(f"whose.{whose}"))

    def stroke(
        self, catalogue: Catalogue, stroke: int, whose: str, *, met: int = -1, hands: tuple[str | None, str | None] = (None, None)
    ) -> str:
        """A stroke, such as ``a straight push with the forehand to their backhand side``; ``met``: area where it is met (-1:
        unknown, or a serve, which have no direction); ``hands``: of striker and receiver (None: unknown)."""
        shot, target = SHOTS[catalogue.shot[stroke]], int(catalogue.area[stroke])
        if catalogue.is_serve[stroke]:  # it flies diagonally into one service court, of which only the side is a choice
            flicked = (shot, catalogue.technique[stroke]) == ("long-serve", TECHNIQUES.index("backhand"))
            return self(
                f"stroke.{'flick_serve' if flicked else 'served'}",
                shot=self.shot(shot),
                direction=self(f"directions.{AREAS[target].split('-')[1]}"),
            )
        fields = {"technique": self.technique(TECHNIQUES[catalogue.technique[stroke]]), "area": self.area(target, whose)}
        if shot in AT_BODY and AREAS[target] == "middle-centre":
            return self("stroke.at_body", shot=self.shot(shot), technique=fields["technique"])
        if shot not in DIRECTED or met < 0 or _CENTRE in (met % N_SIDES, target % N_SIDES):
            text = self("stroke.aimed", shot=self.shot(shot), **fields)
        else:
            along = straight(np.array(met), np.array(target), opposite=(hands[0] == "left") != (hands[1] == "left"))
            direction = self(f"directions.{DIRECTIONS[0 if along else 2]}")
            text = self("stroke.directed", shot=self.shot(shot, 0), direction=direction, **fields)
        return self._deep(SHOTS.index(shot), target, text)

    def hands(self, players: Iterable[str], hands: Iterable[str | None]) -> str:
        """Players with their hands, such as ``Kento Momota, left-handed``; None: unknown."""
        return " · ".join(self(f"hands.{hand or 'unknown'}", name=name) for name, hand in zip(players, hands, strict=True))

    def ending(self, row: "RallyRow") -> str:
        """How a rally ended, and with which stroke."""
        return self(f"endings.{row.ending}", shot=self.shot(row.last_shot, 0))

    def habit(self, habit: Habit, whose: str = "receiver") -> str:
        """A habit, such as ``smashes after lifts``; ``whose`` half the strokes fly to."""
        fields = dict.fromkeys(("direction", "shots", "area", "about", "height"), "")
        if habit.answer in SHOTS:
            fields["shots"] = self.shots(habit.answer)
        elif habit.kind == "targets":
            fields["area"] = self.area(AREAS.index(habit.answer), whose)
        else:
            fields["direction"] = self(f"directions.{habit.answer}")
        if habit.about:
            fields["about"] = self.shots(habit.about[0])
        if len(habit.about) > 1:
            fields["height"] = self(f"heights.{habit.about[1]}")
        return self(f"habit.{habit.kind}", **fields)

    def strokes_with(self, shot: str, technique: str | None = None) -> str:
        """Strokes of a shot type, such as ``clears with the backhand``; None: with any technique."""
        if technique is None:
            return self.shots(shot)
        return self("stroke.with", shots=self.shots(shot), technique=self.technique(technique))

    def situation(self, place: Situation, whose: str) -> str:
        """A situation, such as ``against a lift to your rear forehand corner, met above the net``."""
        if place.shot < 0:
            return self("brief.when_serving")
        said = {
            "shot": self.shot(SHOTS[place.shot]),
            "area": self.area(place.area, whose),
            "height": self(f"heights.{HEIGHTS[place.contact]}"),
        }
        return self("brief.when_hurried" if place.hurried else "brief.when", **said)

    def statement(self, said: "Statement", players: Sequence[str], *, match: bool) -> str:
        """A statement of page 1 as a sentence; ``match``: of a match, whose players are compared with each other."""
        figure, others = said.figure, players[1 - said.player] if match else self("brief.others")
        shares = {"share": of_100(said.value), "usual": of_100(said.usual), "strokes": said.count, "others": others}
        if isinstance(figure, Habit) and said.kind in ENDS:
            text = self(f"brief.{said.kind}", shots=self.strokes_with(*figure.about), **shares)
        elif isinstance(figure, Habit):
            whose = "receiver" if match or not players[1 - said.player] else "your"
            text = self("brief.habit", habit=self.habit(figure, whose), **shares)
        elif isinstance(figure, Difference):
            ends = {name: metres(getattr(figure, name)) for name in ("low", "high")}
            fields = {
                "metres": metres(figure.value),
                "strokes": said.count,
                "others": others if match else self("waits.others"),
                **ends,
            }
            text = self(f"brief.{figure.kind}", shots=self.shots(figure.wait.shot), **fields)
        elif isinstance(figure, Option):
            counts = {"won": figure.won, "rallies": figure.rallies, "others_won": figure.others_won, "others": figure.others}
            when = self.situation(figure.situation, "your")
            text = self("brief.option", when=when, shots=self.shots(SHOTS[figure.shot]), **counts)
        else:
            about = self.shots(figure.about) if figure.about else ""
            text = self(f"brief.{figure.kind}", shots=about, most=self.most(figure), strokes=said.count)
        return self.capital(text)


@functools.cache
def _words(language: Language) -> Words:
    return Words(language)


def words() -> Words:
    """The texts of the current language."""
    return _words(current())


def of_100(share: float, digits: int = 0) -> str:
    """A share as a number of 100."""
    return words().number(round(100 * share, digits) + 0.0, f".{digits}f")  # adding 0 turns a rounded -0.0 into 0.0


def parts(share: Estimate, digits: int = 0) -> dict[str, str]:
    """Value, low and high end of a share as numbers of 100."""
    return {name: of_100(part, digits) for name, part in share._asdict().items()}


def ranged(share: Estimate, digits: int = 0) -> str:
    """A share as a number of 100 with its interval."""
    return words()("report.interval", **parts(share, digits))


def between(low: float, high: float) -> str:
    """An interval of shares as numbers of 100."""
    return words()("report.range", low=of_100(low), high=of_100(high))


def metres(value: float, digits: int = 2) -> str:
    """A distance [m] without its sign."""
    return words().number(abs(value), f".{digits}f")


def signed(share: float, digits: int = 1) -> str:
    """A difference of shares as a number of 100 with its sign."""
    number = round(100 * share, digits)
    return words().number(number or 0.0, f"+.{digits}f" if number else f".{digits}f")
