"""What stands around the court in a picture: score, the strokes of the rally, and the chip of the last one."""

from collections.abc import Iterator
from typing import Final

from shuttle_marl.env.painting import (
    EDGE,
    GREEN,
    INK,
    MUTED,
    PANEL,
    PLAYERS,
    RED,
    SELECTED,
    TEXT,
    YELLOW,
    Colour,
    Layer,
    Picture,
    text_width,
)
from shuttle_marl.env.snapshot import Snapshot
from shuttle_marl.env.tables import Stroke
from shuttle_marl.env.text import shot_in_words, standing
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.rally import FAULT, OUTCOMES, WINNER
from shuttle_marl.game.stroke import HEIGHTS, TECHNIQUES

SIZE: Final = (1200, 584)
"""Width and height of the picture [px]."""

_FLOOR: Final = (27, 44, 84)
_STAGE: Final = (12, 12, 876, 560)
_LIST: Final = (900, 12, 288, 560)
_LIST_TOP: Final = 58
_ROW: Final = 27
_ROWS: Final = 17
_SCORE: Final = (24, 24)
_NAME_WIDTH: Final = 126
_GAME_WIDTH: Final = 34
_CHIP: Final = (24, 514, 46)
_PAD: Final = 14
_SMALL: Final = 15
_NORMAL: Final = 20
_LARGE: Final = 25


def paint_stage(layer: Layer) -> None:
    """The floor around the court and the empty list."""
    x, y, w, h = _STAGE
    layer.rect(x, y, w, h, _FLOOR, radius=10)
    layer.frame(x, y, w, h, EDGE, width=1, radius=10)
    x, y, w, h = _LIST
    layer.rect(x, y, w, h, PANEL, radius=10)
    layer.frame(x, y, w, h, EDGE, width=1, radius=10)


def paint_boxes(layer: Layer, snapshot: Snapshot) -> None:
    """Everything under the text."""
    x, y = _SCORE
    width = _NAME_WIDTH + _GAME_WIDTH * max(1, len(snapshot.by_game)) + 8
    layer.rect(x, y, width, 56, INK, 235, radius=6)
    for player in (0, 1):
        layer.rect(x, y + 28 * player, 4, 28, PLAYERS[player])
    current = x + width - _GAME_WIDTH - 4
    if snapshot.by_game:
        layer.rect(current, y + 3, _GAME_WIDTH, 50, SELECTED, radius=4)
    serving = snapshot.winner if snapshot.winner is not None else snapshot.server
    layer.circle((x + 16, y + 14 + 28 * serving), 4.5, YELLOW)
    for row, (_, played) in enumerate(_listed(snapshot)):
        top = _LIST_TOP + _ROW * row
        if played is snapshot.strokes[-1]:
            layer.rect(_LIST[0] + 8, top - _ROW / 2 + 1, _LIST[2] - 16, _ROW - 2, SELECTED, radius=4)
        layer.circle((_LIST[0] + 42, top), 4, PLAYERS[played.player])
    if snapshot.strokes:
        last = snapshot.strokes[-1]
        x, y, height = _CHIP
        cells = sum((_cell_width(label, value) for label, value, _ in _cells(snapshot, last)), 0.0)
        head = text_width(shot_in_words(snapshot.game.catalogue, last.stroke).upper(), _LARGE) + 2 * _PAD
        layer.rect(x, y, head + cells, height, INK, 235, radius=8)
        layer.rect(x, y, head, height, PLAYERS[last.player], radius=8)
        layer.rect(x + head - 8, y, 8, height, PLAYERS[last.player])


def write_overlay(picture: Picture, snapshot: Snapshot) -> None:
    """All text."""
    _write_score(picture, snapshot)
    _write_list(picture, snapshot)
    if snapshot.strokes:
        _write_chip(picture, snapshot, snapshot.strokes[-1])


def _write_score(picture: Picture, snapshot: Snapshot) -> None:
    x, y = _SCORE
    for player, name in enumerate(snapshot.names):
        middle = y + 14 + 28 * player
        picture.write(name, (x + 28, middle), _NORMAL)
        for column, points in enumerate(snapshot.by_game):
            current = column == len(snapshot.by_game) - 1
            at = (x + _NAME_WIDTH + _GAME_WIDTH * (column + 0.5) + 4, middle)
            won = points[player] > points[1 - player]
            picture.write(str(points[player]), at, _LARGE if current else _NORMAL, TEXT if won or current else MUTED, "center")
        if not snapshot.by_game and snapshot.winner == player:
            picture.write("won", (x + _NAME_WIDTH + _GAME_WIDTH / 2, middle), _NORMAL, GREEN, "center")
    right = _STAGE[0] + _STAGE[2] - 14
    picture.write(snapshot.title, (right, y + 10), _NORMAL, MUTED, "midright")


def _write_list(picture: Picture, snapshot: Snapshot) -> None:
    left, top, width, height = _LIST
    right = left + width - 16
    count = len(snapshot.strokes)
    picture.write(f"RALLY - {count} STROKE{'' if count == 1 else 'S'}", (left + 16, top + 20), _SMALL, MUTED)
    picture.write("GOOD", (right - 38, top + 20), _SMALL, MUTED, "midright")
    picture.write("RET.", (right, top + 20), _SMALL, MUTED, "midright")
    catalogue = snapshot.game.catalogue
    for row, (number, played) in enumerate(_listed(snapshot)):
        middle = _LIST_TOP + _ROW * row
        picture.write(str(number), (left + 28, middle), _SMALL, MUTED, "midright")
        end = left + 54 + picture.write(shot_in_words(catalogue, played.stroke), (left + 54, middle), _NORMAL)
        area = AREAS[catalogue.area[played.stroke]].replace("-", " ")
        if end + 8 + text_width(area, _SMALL) < right - 74:
            picture.write(area, (end + 8, middle + 1), _SMALL, MUTED)
        picture.write(f"{played.p_succ:.2f}"[-3:], (right - 38, middle), _NORMAL, GREEN, "midright")
        picture.write(f"{played.p_ret:.2f}", (right, middle), _NORMAL, YELLOW, "midright")
    bottom = top + height - 24
    colour = TEXT if snapshot.winner is None else PLAYERS[snapshot.winner]
    picture.write(standing(snapshot), (left + 16, bottom), _NORMAL, colour)


def _write_chip(picture: Picture, snapshot: Snapshot, last: Stroke) -> None:
    x, y, height = _CHIP
    name = shot_in_words(snapshot.game.catalogue, last.stroke).upper()
    at = x + _PAD + picture.write(name, (x + _PAD, y + height / 2), _LARGE, INK) + _PAD
    for label, value, colour in _cells(snapshot, last):
        picture.write(label, (at + _PAD, y + 14), _SMALL, MUTED)
        picture.write(value, (at + _PAD, y + 32), _NORMAL, colour)
        at += _cell_width(label, value)


def _cells(snapshot: Snapshot, last: Stroke) -> Iterator[tuple[str, str, Colour]]:
    catalogue = snapshot.game.catalogue
    yield "TARGET", AREAS[catalogue.area[last.stroke]].replace("-", " "), TEXT
    yield "CONTACT", f"{HEIGHTS[catalogue.height[last.stroke]]} net", TEXT
    yield "TECHNIQUE", TECHNIQUES[catalogue.technique[last.stroke]].replace("-", " "), TEXT
    yield "P(SUCCESS)", f"{last.p_succ:.3f}", GREEN
    yield "P(RETURNED)", f"{last.p_ret:.3f}", YELLOW
    colour = {FAULT: RED, WINNER: GREEN}.get(last.outcome, TEXT)
    yield "OUTCOME", OUTCOMES[last.outcome], colour


def _cell_width(label: str, value: str) -> float:
    return max(text_width(label, _SMALL), text_width(value, _NORMAL)) + 2 * _PAD


def _listed(snapshot: Snapshot) -> list[tuple[int, Stroke]]:
    """The last strokes with their numbers, as many as fit."""
    return list(enumerate(snapshot.strokes, start=1))[-_ROWS:]
