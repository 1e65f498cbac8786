"""Random matches of two games, and files in which a program or a person would write them."""

import csv
import dataclasses
import io
import random
from collections.abc import Iterator, Sequence
from typing import Final

SHOTS: Final = ("lift", "net-shot", "drive", "push", "block", "clear")
UNITS: Final = {"s": 1.0, "ms": 1000.0, "frames": 25.0, "minutes": 1 / 60}


@dataclasses.dataclass(frozen=True)
class Written:
    """A stroke, as it was.

    Attributes:
        who: 0 or 1, the player.
        ending, winner: of the last stroke of a rally; else empty, and None.
        score: of players 0 and 1 after the rally.
        before: before it.
    """

    match: str
    game: int
    rally: int
    stroke: int
    players: tuple[str, str]
    who: int
    shot: str
    seconds: float
    ending: str
    winner: int | None
    score: tuple[int, int]
    before: tuple[int, int]
    server: int

    @property
    def player(self) -> str:
        return self.players[self.who]


def match(seed: int, name: str, players: tuple[str, str], games: Sequence[int] = (1, 2), rallies: int = 6) -> list[Written]:
    """A random match."""
    rng = random.Random(seed)
    strokes: list[Written] = []
    seconds, server = rng.uniform(0, 5), rng.randrange(2)
    for game in games:
        score = [0, 0]
        for rally in range(1, rng.randint(3, rallies) + 1):
            length, fault = rng.randint(1, 5), rng.random() < 0.6
            last = (server + length - 1) % 2
            winner = 1 - last if fault else last
            before = (score[0], score[1])
            score[winner] += 1
            for stroke in range(1, length + 1):
                who, ends = (server + stroke - 1) % 2, stroke == length
                strokes.append(
                    Written(
                        match=name, game=game, rally=rally, stroke=stroke, players=players, who=who,
                        shot="short-serve" if stroke == 1 else rng.choice(SHOTS), seconds=round(seconds, 3),
                        ending=("out" if fault else "landed") if ends else "", winner=winner,
                        score=(score[0], score[1]), before=before, server=server,
                    )
                )  # fmt: skip
                seconds += rng.uniform(0.7, 1.4)
            seconds += rng.uniform(7, 14)
            server = winner
    return strokes


def score_of(stroke: Written, kind: str) -> str:
    """The score of a rally: of player 0, of the server, or of who struck first in the game, first; after or before it."""
    both = stroke.before if kind.endswith("before") else stroke.score
    first = 1 if kind.startswith("one") and stroke.match.endswith("away") else stroke.server if kind.startswith("server") else 0
    return f"{both[first]}-{both[1 - first]}"


def entries(strokes: Sequence[Written], columns: Sequence[str], *, unit: str = "s") -> list[dict[str, str]]:
    """Rows with some columns."""
    rows = []
    for stroke in strokes:
        everything: dict[str, str] = {
            "match": stroke.match, "game": str(stroke.game), "rally": str(stroke.rally), "stroke": str(stroke.stroke),
            "player": stroke.player, "opponent": stroke.players[1 - stroke.who], "shot": stroke.shot, "ending": stroke.ending,
            "winner": "" if stroke.winner is None else stroke.players[stroke.winner],
            "seconds": f"{stroke.seconds * UNITS[unit]:.6f}", **{kind: score_of(stroke, kind) for kind in SCORES},
        }  # fmt: skip
        rows.append({"score" if name in SCORES else name: everything[name] for name in columns})
    return rows


SCORES: Final = ("one's after", "one's before", "server's after", "server's before")


def as_csv(rows: Sequence[dict[str, str]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_sportscode(rows: Sequence[dict[str, str]]) -> str:
    def instances() -> Iterator[str]:
        for row in rows:
            labels = "".join(
                f"<label><group>{name}</group><text>{value}</text></label>"
                for name, value in row.items()
                if value and name not in ("seconds", "player")
            )
            start = float(row["seconds"])
            times = f"<start>{start:.6f}</start><end>{start + 0.3:.6f}</end>"
            yield f"<instance>{times}<code>{row['player']}</code>{labels}</instance>"

    return f"<file><ALL_INSTANCES>{''.join(instances())}</ALL_INSTANCES></file>"
