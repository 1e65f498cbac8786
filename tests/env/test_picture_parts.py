"""Painted parts of a picture and their positions, worked out by hand in pixels or in metres on the court."""

import dataclasses
import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.env import picture
from shuttle_marl.env.picture import GREEN, INK, LINE, MUTED, PLAYERS, RED, SELECTED, TEXT, WHITE, YELLOW, Sheet
from shuttle_marl.env.snapshot import Flight, Plan, Snapshot
from shuttle_marl.game.court import area_box
from shuttle_marl.game.rally.stepper import Stroke
from shuttle_marl.game.rules import FAULT, HURRIED_ABOVE, RETURNED_ABOVE, RETURNED_BELOW, WINNER
from tests.exact.exact_games import hand_made, tiring_game

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
pygame = pytest.importorskip("pygame")

Drawn = tuple[Any, ...]
GAME = hand_made()
SERVE, SMASH, LIFT = (GAME.catalogue.names.index(name) for name in GAME.catalogue.names)


def plain(value: Any) -> Any:
    """A position as numbers to a thousandth of a pixel."""
    return np.round(np.asarray(value, dtype=float), 3).tolist()


class Notes(Sheet):
    """A sheet that notes what is painted; every text is 50 pixels wide."""

    def __init__(self) -> None:
        self.rects: list[Drawn] = []
        self.circles: list[Drawn] = []
        self.polygons: list[Drawn] = []
        self.lines: list[Drawn] = []
        self.texts: list[Drawn] = []

    def rect(self, box: Any, colour: Any, alpha: int = 255, *, width: float = 0, radius: float = 0) -> None:
        self.rects.append((plain(box), colour, alpha, width, radius))

    def circle(self, at: Any, radius: float, colour: Any, alpha: int = 255, *, width: float = 0) -> None:
        self.circles.append((plain(at), radius, colour, alpha, width))

    def polygon(self, points: Any, colour: Any, alpha: int = 255) -> None:
        self.polygons.append((plain(points), colour, alpha))

    def line(self, a: Any, b: Any, width: float, colour: Any, alpha: int = 255) -> None:
        self.lines.append((plain(a), plain(b), round(width, 3), colour, alpha))

    def write(self, text: str, x: float, y: float, size: int, colour: Any = TEXT, anchor: str = "midleft") -> float:
        self.texts.append((text, round(x, 3), round(y, 3), size, colour, anchor))
        return 50.0


@pytest.fixture
def notes() -> Notes:
    return Notes()


def stroke(player: int, outcome: int = RETURNED_BELOW, number: int = LIFT) -> Stroke:
    return Stroke(player, number, outcome, 0.75, 0.5)


def flight(start: tuple[float, float], end: tuple[float, float], *, peak: float = 0.0, by: Stroke | None = None) -> Flight:
    return Flight(stroke=by or stroke(0), start=start, end=end, peak=peak)


def plan(*flights: Flight, **changes: Any) -> Plan:
    made: dict[str, Any] = {"shuttle": (0.0, 0.0), "bodies": ((-3.0, 0.0), (3.0, 0.0)), "came_from": (None, None)}
    return Plan(flights=flights, **{**made, **changes})


def snapshot(*strokes: Stroke, **changes: Any) -> Snapshot:
    made: dict[str, Any] = {"game": GAME, "names": ("Ann", "Bea"), "title": "rally 1", "server": 0, "striker": 0, "winner": None}
    return Snapshot(strokes=strokes, **{**made, "reason": None, **changes})


def test_the_net_is_in_the_middle_and_a_metre_has_51_pixels() -> None:
    assert picture.px((0, 0)).tolist() == [450, 292]
    assert picture.px((1, -2)).tolist() == [501, 190]
    # A picture of 12 pixels around a stage of 876 by 560, with as much between it and the list of 288 pixels.
    assert picture.SIZE == (12 + 876 + 12 + 288 + 12, 12 + 560 + 12)


def test_lines_of_the_court_are_those_of_the_laws(notes: Notes) -> None:
    picture._paint_court(notes)
    found = sorted(plain((np.array(line[:2]) - [450, 292]) / 51) for line in notes.lines)
    expected = []
    for side in (-1, 1):
        # The back boundary line, and the long and the short service line.
        expected += [[[side * x, -3.05], [side * x, 3.05]] for x in (6.7, 5.94, 1.98)]
        expected += [[[-6.7, side * y], [6.7, side * y]] for y in (2.59, 3.05)]
        expected += [[[side * 1.98, 0.0], [side * 6.7, 0.0]]]
    assert found == sorted(expected)
    assert {line[2:] for line in notes.lines} == {(2.55, LINE, 255)}, "lines are 5 cm wide"
    stage, stage_edge, listed, list_edge, dark, mat = notes.rects
    assert stage == ([12, 12, 876, 560], (27, 44, 84), 255, 0, 10)
    assert listed == ([900, 12, 288, 560], (19, 26, 38), 255, 0, 10)
    assert (stage_edge, list_edge) == ((stage[0], (36, 48, 68), 255, 1, 10), (listed[0], (36, 48, 68), 255, 1, 10))
    assert dark == (plain([450 - 51 * 7.7, 292 - 51 * 4.05, 102 * 7.7, 102 * 4.05]), (14, 93, 72), 255, 0, 10)
    assert mat == (plain([450 - 51 * 6.7, 292 - 51 * 3.05, 102 * 6.7, 102 * 3.05]), (18, 114, 87), 255, 0, 0)


def test_the_net_hangs_between_posts_and_has_a_shadow(notes: Notes) -> None:
    picture._paint_net(notes)
    top, bottom = 292 - 51 * 3.1, 292 + 51 * 3.1
    shadow, net, *dashes = notes.lines
    assert shadow == (plain([450 + 51 * 0.06, top]), plain([450 + 51 * 0.06, bottom]), 5, INK, 90)
    assert net == (plain([450, top]), plain([450, bottom]), 3.2, WHITE, 255)
    # Every 16 cm a dash of 4 cm: 39 of them fit into 6.2 m.
    assert len(dashes) == 39
    for i, dash in enumerate(dashes):
        at = top + 51 * 0.16 * i
        assert dash == (plain([450, at]), plain([450, at + 51 * 0.04]), 3.2, (150, 165, 175), 255)
    ends = [plain([450, top]), plain([450, bottom])]
    posts = [(at, radius, colour, 255, 0) for at in ends for radius, colour in ((5.5, INK), (4, (200, 208, 216)))]
    assert notes.circles == posts


@pytest.mark.parametrize("player", [0, 1])
def test_nine_areas_are_shown_in_the_half_of_the_receiver(notes: Notes, player: int) -> None:
    picture._paint_target(notes, player, 3)
    boxes = []
    for area in range(9):
        (left, right), (near, far) = area_box(area)
        # Player 0 aims to the right of the net, where down is the right side; for player 1 all is turned round.
        first = (450 + 51 * near, 292 + 51 * left) if player == 0 else (450 - 51 * far, 292 - 51 * right)
        boxes.append(plain([*first, 51 * (far - near), 51 * (right - left)]))
    aimed = [(boxes[3], YELLOW, 88, 0, 0), (boxes[3], YELLOW, 255, 1.8, 0)]
    others = [(box, LINE, 46, 1, 0) for area, box in enumerate(boxes) if area != 3]
    assert notes.rects == [*others[:3], *aimed, *others[3:]]


def test_flights_are_highest_behind_their_middle() -> None:
    points = picture._flight_points(flight((0, 0), (3, 1), peak=2.0), 4)
    # After two thirds of the way the shuttle is 2 m above the straight line, 17 pixels a metre.
    straight = [[450.0 + 51 * x, 292.0 + 17 * x] for x in (0, 1, 2, 3)]
    straight[1][1] -= 17 * 2 * 6.75 * 2 / 27
    straight[2][1] -= 34
    assert points == pytest.approx(np.array(straight))
    assert len(picture._flight_points(flight((0, 0), (1, 1)))) == 48


def test_older_flights_are_fainter_and_faults_are_dashed(notes: Notes) -> None:
    flights = [flight((float(i), 0), (float(i) + 1, 0), by=stroke(i % 2)) for i in range(7)]
    picture._paint_flights(notes, tuple(flights))
    assert len(notes.lines) == 5 * 47
    starts = [(plain([450 + 51 * i, 292]), i) for i in (2, 3, 4, 5, 6)]
    alphas = (64, 71, 107, 158, 255)  # 25 %, at the least; 28, 42, 62 and 100 %
    assert notes.circles == [
        (at, 3.4 if i == 6 else 2.4, PLAYERS[i % 2], alpha, 0) for (at, i), alpha in zip(starts, alphas, strict=True)
    ]
    oldest, newest = notes.lines[0], notes.lines[-47:]
    assert oldest[2:] == (2.0, PLAYERS[0], round(255 * 0.16 * 0.45))
    assert newest[0][2:] == (1.6, PLAYERS[0], 115)
    assert newest[46][2:] == (round(1.6 + 3 * 46 / 47, 3), PLAYERS[0], round(255 * (0.45 + 0.55 * 46 / 47)))
    assert newest[0][:2] == (plain([450 + 51 * 6, 292]), plain([450 + 51 * (6 + 1 / 47), 292]))
    fault = Notes()
    picture._paint_flights(fault, (flight((0, 0), (1, 0), by=stroke(1, FAULT)),))
    ends = [round((line[0][0] - 450) / 51 * 47) for line in fault.lines]
    assert ends == [i for i in range(47) if i % 4 in (0, 1)]


@pytest.mark.parametrize("hand", ["right", "left"])
def test_a_player_looks_at_the_shuttle_with_the_racket_at_the_side_of_the_hand(notes: Notes, hand: str) -> None:
    picture._paint_player(notes, snapshot(hands=(hand, "right"), striker=1), (-3.0, 0.0), (0.0, 0.0), 0)
    x, y, side = 297, 292, 1 if hand == "right" else -1  # a right-handed player who looks to the right has it below
    arm, shaft = notes.lines
    assert arm == (plain([x, y + side * 12.5]), plain([x + 11.25, y + side * 13.75]), 6, (28, 94, 124), 255)
    assert shaft == (plain([x + 11.25, y + side * 13.75]), plain([x + 30, y + side * 13.75]), 2.2, WHITE, 255)
    shadow, strings, frame, hair, face = notes.circles
    assert shadow == (plain([x + 3, y + 5]), 15, INK, 90, 0)
    assert strings == (plain([x + 37.5, y + side * 13.75]), 8, WHITE, 80, 0)
    assert frame == (strings[0], 8, WHITE, 255, 1.5)
    assert hair == (plain([x + 1.875, y]), 8, INK, 255, 0)
    assert face == (hair[0], 6.8, (238, 205, 175), 255, 0)
    ((points, colour, alpha),) = notes.polygons
    assert (len(points), colour, alpha) == (28, PLAYERS[0], 255)
    shoulders = np.array(points) - [x, y]
    assert (shoulders[0].tolist(), shoulders[14].tolist()) == ([8.75, 0], [-8.75, 0])
    assert (shoulders[7].tolist(), shoulders[21].tolist()) == ([0, side * 17.5], [0, side * -17.5])


def test_the_striker_has_a_ring(notes: Notes) -> None:
    picture._paint_player(notes, snapshot(striker=1), (3.0, 1.0), (0.0, 1.0), 1)
    at = plain([603, 343])
    assert notes.circles[:2] == [(at, 26, PLAYERS[1], 60, 0), (at, 26, PLAYERS[1], 230, 2)]
    assert len(notes.circles) == 7
    assert notes.lines[1][1] == plain([603 - 30, 343 - 13.75]), "who looks to the left has the right hand above"


def test_paths_on_the_floor_and_where_a_receiver_waited(notes: Notes) -> None:
    flights = [flight((float(i), 0), (float(i) + 1, 0)) for i in range(3)]
    picture._paint_floor(notes, plan(*flights, came_from=(None, (3.0, 2.0)), waited=(1.0, 1.0)))
    assert notes.lines == [
        (plain([450 + 51 * i, 292]), plain([501 + 51 * i, 292]), 2.0, INK, alpha) for i, alpha in ((2, 70), (1, 35))
    ]
    *steps, disc, ring = notes.circles
    # From (3, 2) to the body at (3, 0) in eight steps of 14 %.
    assert steps == [(plain([603, 292 + 102 * (1 - 0.14 * i)]), 2.2, PLAYERS[1], round(50 + 110 * 0.14 * i), 0) for i in range(8)]
    assert (disc, ring) == ((plain([501, 343]), 30, WHITE, 60, 0), (plain([501, 343]), 30, WHITE, 200, 2))
    empty = Notes()
    picture._paint_floor(empty, plan())
    assert not empty.circles
    assert not empty.lines


def test_the_shuttle_flies_cork_first(notes: Notes) -> None:
    picture._paint_shuttle(notes, plan())
    skirt = np.array([[-11, 6.5], [-11, -6.5], [-1, -2.4], [-1, 2.4]])
    assert notes.polygons == [(plain(picture.CENTRE + skirt), WHITE, 255)]
    assert notes.circles == [(plain([450, 292]), 3.4, YELLOW, 255, 0)]
    for direction, turned in (((0.0, 2.0), skirt[:, ::-1] * [-1, 1]), ((-2.0, 0.0), -skirt)):
        found = Notes()
        picture._paint_shuttle(found, plan(flight((0, 0), direction), shuttle=direction))
        assert np.array(found.polygons[0][0]) == pytest.approx(np.array(picture.px(direction) + turned))
    falling = Notes()
    picture._paint_shuttle(falling, plan(flight((0, 0), (2.0, 0.0), peak=4.0), shuttle=(2.0, 0.0)))
    # Over the last two of 47 parts of the flight it comes 2/47 of 102 pixels nearer and falls 27 m * (45/47)^2 * 2/47.
    last = np.array([102 * 2 / 47, 17 * 27 * (45 / 47) ** 2 * 2 / 47])
    back = np.mean(falling.polygons[0][0][:2], axis=0) - picture.px((2.0, 0.0))
    assert back == pytest.approx(-11 * last / np.hypot(*last), abs=0.01)


def test_a_mark_shows_how_a_rally_ended(notes: Notes) -> None:
    picture._paint_shuttle(notes, plan(flight((0, 0), (1, 0), by=stroke(0, WINNER)), shuttle=(1.0, 0.0)))
    assert notes.circles == [(plain([501, 292]), radius, GREEN, alpha, 2) for radius, alpha in ((26, 90), (18, 170), (10, 255))]
    fault = Notes()
    picture._paint_shuttle(fault, plan(flight((0, 0), (1, 0), by=stroke(0, FAULT)), shuttle=(1.0, 0.0)))
    assert fault.lines == [
        (plain([492, 283]), plain([510, 301]), 4, RED, 255),
        (plain([492, 301]), plain([510, 283]), 4, RED, 255),
    ]
    assert not notes.polygons
    assert not fault.polygons


def test_the_score_shows_points_of_games_and_who_serves(notes: Notes) -> None:
    picture._paint_score(notes, snapshot(by_game=((21, 15), (3, 8)), server=1))
    # 126 pixels for the names, 34 for each of two games, and 8.
    box, current, first, second = notes.rects
    assert box == ([24, 24, 202, 56], INK, 235, 0, 6)
    assert current == ([24 + 202 - 38, 27, 34, 50], SELECTED, 255, 0, 4)
    assert (first, second) == (([24, 24, 4, 28], PLAYERS[0], 255, 0, 0), ([24, 52, 4, 28], PLAYERS[1], 255, 0, 0))
    assert notes.circles == [([40, 66], 4.5, YELLOW, 255, 0)]
    columns = [24 + 126 + 17 + 4, 24 + 126 + 51 + 4]
    assert notes.texts == [
        ("Ann", 52, 38, 20, TEXT, "midleft"),
        ("21", columns[0], 38, 20, TEXT, "center"),
        ("3", columns[1], 38, 25, TEXT, "center"),
        ("Bea", 52, 66, 20, TEXT, "midleft"),
        ("15", columns[0], 66, 20, MUTED, "center"),
        ("8", columns[1], 66, 25, TEXT, "center"),
        ("rally 1", 874, 34, 20, MUTED, "midright"),
    ]


def test_a_rally_without_a_match_shows_efforts_and_its_winner(notes: Notes) -> None:
    game = tiring_game()  # three levels of effort
    smash = game.catalogue.names.index("smash:middle-left:above:forehand")
    strokes = [stroke(0, number=0), stroke(1, WINNER, smash)]
    picture._paint_score(notes, snapshot(*strokes, game=game, winner=1, striker=None, reason="winner"))
    assert notes.rects[0] == ([24, 24, 126 + 84 + 34 + 8, 56], INK, 235, 0, 6)
    assert len(notes.rects) == 3
    assert notes.circles == [([40, 66], 4.5, YELLOW, 255, 0)]
    assert notes.texts == [
        ("Ann", 52, 38, 20, TEXT, "midleft"),
        ("effort 0 of 2", 112, 39, 15, MUTED, "midleft"),
        ("Bea", 52, 66, 20, TEXT, "midleft"),
        ("effort 1 of 2", 112, 67, 15, MUTED, "midleft"),
        ("won", 24 + 210 + 17, 66, 20, GREEN, "center"),
        ("rally 1", 874, 34, 20, MUTED, "midright"),
    ]


def by_letters(text: str, size: int) -> float:
    """Width of a text whose letters are all alike."""
    return float(len(text) * size / 5)


def test_the_list_shows_the_last_strokes_with_their_probabilities(notes: Notes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "text_width", by_letters)
    strokes = [stroke(0, number=SERVE), *(stroke(i % 2) for i in range(1, 18)), stroke(0, WINNER, SMASH)]
    picture._paint_list(notes, snapshot(*strokes, winner=0, striker=None, reason="winner"))
    head, good, returned, *rows, standing = notes.texts
    assert head == ("RALLY - 19 STROKES", 916, 32, 15, MUTED, "midleft")
    assert good == ("GOOD", 1134, 32, 15, MUTED, "midright")
    assert returned == ("RET.", 1172, 32, 15, MUTED, "midright")
    assert standing == ("Ann wins the rally (winner)", 916, 548, 20, PLAYERS[0], "midleft")
    # Seventeen rows of 27 pixels: strokes 3 to 19.
    assert [text[0] for text in rows[::5]] == [str(number) for number in range(3, 20)]
    assert rows[:5] == [
        ("3", 928, 58, 15, MUTED, "midright"),
        ("lift", 954, 58, 20, TEXT, "midleft"),
        ("back centre", 1012, 59, 15, MUTED, "midleft"),
        ("0.75", 1134, 58, 20, GREEN, "midright"),
        ("0.50", 1172, 58, 20, YELLOW, "midright"),
    ]
    last = 58 + 27 * 16
    assert [text[2] for text in rows[-5:]] == [last, last, last + 1, last, last]
    assert notes.rects == [([908, last - 12.5, 272, 25], SELECTED, 255, 0, 4)]
    assert notes.circles == [([942, 58 + 27 * i], 4, PLAYERS[i % 2], 255, 0) for i in range(17)]


@pytest.mark.parametrize(("width", "fits"), [(85.9, True), (86.0, False)])
def test_the_area_of_a_stroke_is_listed_where_there_is_room(
    notes: Notes, monkeypatch: pytest.MonkeyPatch, width: float, fits: bool
) -> None:
    # A shot of 50 pixels ends at 1012, and the first probability begins at 1098.
    monkeypatch.setattr(picture, "text_width", lambda *_: width)
    picture._paint_list(notes, snapshot(stroke(1)))
    assert notes.texts[0][0] == "RALLY - 1 STROKE"
    assert ("back centre" in [text[0] for text in notes.texts]) == fits
    assert notes.texts[-1][:5] == ("Ann is to hit", 916, 548, 20, TEXT)


@pytest.mark.parametrize(
    ("outcome", "label", "value", "colour"),
    [
        (FAULT, "OUTCOME", "fault", RED),
        (WINNER, "OUTCOME", "winner", GREEN),
        (RETURNED_BELOW, "RETURNED", "from below", TEXT),
        (RETURNED_ABOVE, "RETURNED", "from above", TEXT),
    ],
)
def test_the_last_stroke_is_shown_in_detail(
    notes: Notes, monkeypatch: pytest.MonkeyPatch, outcome: int, label: str, value: str, colour: Any
) -> None:
    monkeypatch.setattr(picture, "text_width", by_letters)
    picture._paint_chip(notes, snapshot(stroke(0, number=SERVE), stroke(1, outcome, SMASH)))
    cells = [
        ("TARGET", "middle backhand", TEXT), ("CONTACT", "above", TEXT), ("TECHNIQUE", "forehand", TEXT),
        ("P(GOOD)", "0.750", GREEN), ("P(RET.)", "0.500", YELLOW), (label, value, colour),
    ]  # fmt: skip
    # A letter is 3 pixels wide in labels, 4 in values and 5 in the name; 14 on either side.
    widths = [max(3 * len(name), 4 * len(shown)) + 28 for name, shown, _ in cells]
    head = 5 * len("SMASH") + 28
    assert notes.rects == [
        ([24, 514, head + sum(widths), 46], INK, 235, 0, 8),
        ([24, 514, head, 46], PLAYERS[1], 255, 0, 8),
        ([24 + head - 8, 514, 8, 46], PLAYERS[1], 255, 0, 0),
    ]
    assert notes.texts[0] == ("SMASH", 38, 537, 25, INK, "midleft")
    at = 24 + head
    for i, ((name, shown, tint), width) in enumerate(zip(cells, widths, strict=True)):
        assert notes.texts[1 + 2 * i] == (name, at + 14, 528, 15, MUTED, "midleft")
        assert notes.texts[2 + 2 * i] == (shown, at + 14, 546, 20, tint, "midleft")
        at += width


def test_a_hurried_striker_is_named(notes: Notes) -> None:
    picture._paint_list(notes, snapshot(stroke(1, HURRIED_ABOVE)))
    assert notes.texts[-1][0] == "Ann is to hit, hurried"


def pixels(paint: Callable[[Sheet], object]) -> np.ndarray:
    """Opacity of a sheet, ``[width, height]`` in pixels of the sheet."""
    sheet = Sheet()
    paint(sheet)
    assert sheet.surface.get_size() == (2400, 1168)
    return pygame.surfarray.array_alpha(sheet.surface).astype(int)


def extent(alpha: np.ndarray) -> tuple[int, int, int, int]:
    """First and last column and row with paint."""
    x, y = np.nonzero(alpha)
    return int(x.min()), int(x.max()), int(y.min()), int(y.max())


def test_sheets_have_two_pixels_for_each_of_the_picture() -> None:
    filled = pixels(lambda sheet: sheet.rect((10, 20, 30, 40), RED, 90))
    assert extent(filled) == (20, 79, 40, 119)
    assert set(filled[20:80, 40:120].ravel().tolist()) == {90}
    outline = pixels(lambda sheet: sheet.rect((10, 20, 30, 40), RED, width=1.6))
    assert extent(outline) == (20, 79, 40, 119)
    assert outline[22, 80] == 255
    assert outline[23, 80] == 0
    rounded = pixels(lambda sheet: sheet.rect((10, 20, 30, 40), RED, radius=6))
    assert rounded[20, 40] == 0
    assert rounded[32, 40] == 255
    disc = pixels(lambda sheet: sheet.circle(np.array([50.0, 60.0]), 10, RED, 120))
    assert np.array(extent(disc)) == pytest.approx([80, 120, 100, 140], abs=1)
    assert disc[100, 120] == 120
    ring = pixels(lambda sheet: sheet.circle(np.array([50.0, 60.0]), 10, RED, width=2))
    assert (ring[100, 120], ring[100, 102]) == (0, 255)
    triangle = pixels(lambda sheet: sheet.polygon(np.array([[10.0, 10.0], [20.0, 10.0], [10.0, 20.0]]), RED, 77))
    assert (extent(triangle), triangle[22, 22], triangle[39, 39]) == ((20, 40, 20, 40), 77, 0)
    line = pixels(lambda sheet: sheet.line(np.array([10.0, 30.0]), np.array([50.0, 30.0]), 4, RED))
    assert extent(line) == (20, 100, 56, 64)


def test_texts_lie_at_their_anchor() -> None:
    width = picture.text_width("Ann", 20)
    assert width > 15
    assert picture.text_width("AnnAnn", 20) > 1.8 * width
    for anchor, left in (("midleft", 100.0), ("midright", 100.0 - width), ("center", 100.0 - width / 2)):
        sheet = Sheet()
        assert sheet.write("Ann", 100, 50, 20, RED, anchor) == width
        first, last, top, bottom = extent(pygame.surfarray.array_alpha(sheet.surface))
        assert 2 * left - 1 <= first <= 2 * left + 6
        assert 2 * (left + width) - 8 <= last <= 2 * (left + width) + 1
        assert top < 100 < bottom


def test_across_is_to_the_right_of_a_direction() -> None:
    assert picture._across(np.array([2.0, 0.0])).tolist() == [0, 1]
    assert picture._across(np.array([0.0, -3.0])).tolist() == [1, 0]
    assert picture._across(np.zeros(2)).tolist() == [0, 0]


def test_a_picture_is_the_court_with_its_sheets() -> None:
    renderer = picture.CourtRenderer("", fps=0)
    frame = renderer.frame(snapshot())
    assert (frame.shape, frame.dtype) == ((584, 1200, 3), np.uint8)
    assert frame[2, 2].tolist() == list(INK)
    assert frame[100, 950].tolist() == [19, 26, 38], "the list is empty"
    played = renderer.frame(snapshot(stroke(0, number=SERVE)))
    left = dataclasses.replace(snapshot(stroke(0, number=SERVE)), hands=("right", "left"))
    assert (played != frame).any()
    assert (renderer.frame(left) != played).any()
    assert np.array_equal(renderer.frame(snapshot()), frame), "the court itself stays empty"
