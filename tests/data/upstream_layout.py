"""Writes small made-up data sets in the layout, the vocabulary and with the defects of the published ones."""

import csv
import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

SHUTTLESET = "ShuttleSet/set"
SHUTTLESET22 = "CoachAI-Challenge-IJCAI2023/ShuttleSet22/set"
HEADER = (
    "rally,ball_round,time,frame_num,roundscore_A,roundscore_B,player,server,type,aroundhead,backhand,hit_height,hit_area,"
    "hit_x,hit_y,landing_height,landing_area,landing_x,landing_y,lose_reason,win_reason,getpoint_player,flaw,"
    "player_location_area,player_location_x,player_location_y,opponent_location_area,opponent_location_x,"
    "opponent_location_y,db"
)
COLUMNS = HEADER.split(",")
MATCH_HEADER = "id,video,tournament,round,year,month,day,set,duration,winner,loser,downcourt,url"
UNIT = 13.40 / 660
# A camera behind the lower base line: pixels to court units, as in the published homographies.
HOMOGRAPHY = np.array([[1.06, 0.344, -497.9], [0.0119, 4.587, -1176.8], [4.85e-6, 0.00201, 1.0]])

Row = dict[str, str]


@dataclasses.dataclass(frozen=True)
class Hit:
    """One stroke: Chinese type, landing in the striker's frame [m], height 1 above or 2 below the net."""

    type: str
    x: float
    y: float
    height: int = 2
    backhand: bool = False
    around_head: bool = False


SERVE = Hit("發短球", -0.9, 2.2)
LIFT = Hit("挑球", 1.9, 6.0)
CLEAR = Hit("長球", -1.8, 6.1, height=1)
SMASH = Hit("殺球", 1.8, 4.0, height=1)
DROP = Hit("切球", 1.7, 1.5, height=1)


def pixel(x: float, y: float) -> tuple[str, str]:
    """Pixel of a point in image metres (origin under the net, x right, y down)."""
    p = np.linalg.solve(HOMOGRAPHY, [177.5 + x / UNIT, 480 + y / UNIT, 1.0])
    return f"{p[0] / p[2]:.4f}", f"{p[1] / p[2]:.4f}"


def label(x: float, y: float) -> int:
    """Area label of a landing in the striker's frame, right and left as the player sees them in whose half it lies."""
    if y < 0:
        x, y = -x, -y
    right, depth, across = x < 0, y / UNIT, abs(x) / UNIT
    if across > 127.5 or depth > 330:
        if depth > 330:
            return 13
        row = 0 if depth < 114 else 1 if depth < 276 else 2
        return (16, 15, 14)[row] if right else (10, 11, 12)[row]
    row = 0 if depth < 114 else 1 if depth < 276 else 2
    if across <= 73.5:
        return (7, 8, 9)[row]
    return (1, 5, 3)[row] if right else (2, 6, 4)[row]


def mirrored(value: int) -> int:
    """Label with right and left exchanged."""
    return {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 10: 16, 16: 10, 11: 15, 15: 11, 12: 14, 14: 12}.get(value, value)


def rally(
    number: int,
    server: str,
    hits: Sequence[Hit],
    score: tuple[int, int],
    *,
    a_below: bool = True,
    reason: str = "出界",
    winner: str | None = None,
    mirror_below: bool = False,
    frame: int | None = None,
) -> list[Row]:
    """Rows of a rally; the last hit ends it.

    ``a_below``: whether player A plays in the lower half of the image. ``winner``: default the other player for a fault,
    the striker for a winner; ``""`` leaves it out. ``mirror_below``: labels of landings in the lower half are mirrored.
    """
    frame = 1000 * number if frame is None else frame
    rows = []
    contact: tuple[str, str] = ("", "")
    for i, hit in enumerate(hits):
        player = "AB"[("AB".index(server) + i) % 2]
        sign = 1 if (player == "A") == a_below else -1  # ego (x, y) to image: below (sx, -sy) with s = 1
        landing = pixel(sign * hit.x, -sign * hit.y)
        value = label(hit.x, hit.y)
        if mirror_below and -sign * hit.y > 0:
            value = mirrored(value)
        at = f"{frame + 30 * i}"
        seconds = (frame + 30 * i) // 30
        row = dict.fromkeys(COLUMNS, "")
        row |= {
            "rally": str(number), "ball_round": str(i + 1), "frame_num": at, "db": "0",
            "time": f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}",
            "roundscore_A": str(score[0]), "roundscore_B": str(score[1]), "player": player, "type": hit.type,
            "server": "1" if i == 0 else "2", "aroundhead": "1.0" if hit.around_head else "",
            "backhand": "1.0" if hit.backhand else "", "hit_height": f"{hit.height}.0", "landing_height": "",
            "hit_x": contact[0], "hit_y": contact[1], "landing_area": str(value),
            "landing_x": landing[0], "landing_y": landing[1],
        }  # fmt: skip
        row["player_location_x"], row["player_location_y"] = pixel(sign * 0.2, sign * 4.0)
        row["opponent_location_x"], row["opponent_location_y"] = pixel(sign * 0.1, -sign * 3.8)
        contact = landing
        rows.append(row)
    last = rows[-1]
    lost = reason in ("出界", "掛網", "未過網", "犯規", "")
    last["lose_reason"] = reason
    other = "B" if last["player"] == "A" else "A"
    last["getpoint_player"] = (other if lost else last["player"]) if winner is None else winner
    last["server"] = "3"
    return rows


def game(rallies: Iterable[list[Row]]) -> list[Row]:
    """All rows of a game."""
    return [row for rows in rallies for row in rows]


def plain_game(n: int = 4, *, a_below: bool = True, mirror_below: bool = False) -> list[Row]:
    """A game of n rallies without any defect: A wins the odd ones, by a winner, B the even ones, by A's fault."""
    rows, score = [], (0, 0)
    server = "A"
    options: dict[str, Any] = {"a_below": a_below, "mirror_below": mirror_below}
    for i in range(1, n + 1):
        if i % 2:
            score = (score[0] + 1, score[1])
            hits = [SERVE, LIFT, SMASH] if server == "A" else [SERVE, LIFT, CLEAR, SMASH]
            rows.append(rally(i, server, hits, score, reason="對手落地致勝", **options))
            server = "A"
        else:
            score = (score[0], score[1] + 1)
            out = Hit("長球", 2.9, 6.0, height=1)
            hits = [SERVE, LIFT, out] if server == "A" else [SERVE, out]
            rows.append(rally(i, server, hits, score, reason="出界", **options))
            server = "B"
    return game(rows)


class Layout:
    """A data set being written below ``root``."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.lists: dict[str, list[tuple[str, ...]]] = {}
        self.homographies: dict[str, list[tuple[str, str]]] = {}

    def match(
        self,
        name: str,
        games: Sequence[list[Row]],
        *,
        source: str = SHUTTLESET,
        number: int = 1,
        players: tuple[str, str] = ("Viktor AXELSEN", "CHEN Long"),
    ) -> Path:
        """Add a match and return its folder."""
        self.lists.setdefault(source, []).append((str(number), name, str(len(games)), *players))
        self.homographies.setdefault(source, []).append((name, json.dumps(HOMOGRAPHY.tolist())))
        folder = self.root / source / name
        folder.mkdir(parents=True)
        for i, rows in enumerate(games, start=1):
            write_rows(folder / f"set{i}.csv", rows)
        self._write_lists(source)
        return folder

    def _write_lists(self, source: str) -> None:
        folder = self.root / source
        folder.mkdir(parents=True, exist_ok=True)
        rows = [[n, v, "Open", "Finals", "2020", "", "", s, "", w, x, "", ""] for n, v, s, w, x in self.lists[source]]
        write_csv(folder / "match.csv", MATCH_HEADER.split(","), rows)
        write_csv(folder / "homography.csv", ["id", "video", "homography_matrix"], [
            [str(i), name, matrix] for i, (name, matrix) in enumerate(self.homographies[source])
        ])  # fmt: skip


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    write_csv(path, COLUMNS, [[row[column] for column in COLUMNS] for row in rows])


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
