"""Parts of the reports from a few figures: texts of numbers, differences, drills, the course of a match, and its examples."""

import dataclasses
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from shuttle_marl.analysis.habits import Ending, Habit
from shuttle_marl.analysis.summary import AnalysisError
from shuttle_marl.analysis.waits import Place, Wait
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.coach import charts, examples, sources
from shuttle_marl.coach import match_page as match_pages
from shuttle_marl.coach import scout_page as scout_pages
from shuttle_marl.coach.charts import Bar
from shuttle_marl.coach.examples import base91
from shuttle_marl.coach.rendering import Drill, differences, distance, drills, shares, shown_differences
from shuttle_marl.coach.words import Words, between, metres, of_100, parts, ranged, signed
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.pages import Cell, interval, name, number, percent
from shuttle_marl.pages import charts as drawings
from shuttle_marl.pages.languages import speaking

NAN = math.nan
UNKNOWN = Estimate(NAN, NAN, NAN)


def test_numbers_of_100_and_of_metres_as_a_reader_writes_them() -> None:
    share = Estimate(0.1234, 0.05, 0.2)
    assert [of_100(0.1234), of_100(0.1234, 1), of_100(-0.0001), of_100(1)] == ["12", "12.3", "0", "100"]
    assert [signed(0.1234), signed(-0.1234), signed(0.0004), signed(-0.0004), signed(0.126, 0)] == [
        "+12.3",
        "-12.3",
        "0.0",
        "0.0",
        "+13",
    ]
    assert [metres(1.234), metres(-1.236), metres(2.0, 1)] == ["1.23", "1.24", "2.0"]
    assert (ranged(share), between(0.05, 0.2)) == ("12 (5 to 20)", "5 to 20")
    assert parts(share, 1) == {"value": "12.3", "low": "5.0", "high": "20.0"}
    with speaking("id"):
        assert (of_100(0.1234, 1), signed(-0.1234), metres(1.234)) == ("12,3", "-12,3", "1,23")


def test_names_of_players_and_events() -> None:
    say = Words("en")
    assert [say.player(name) for name in ("viktor-axelsen", "club", "Ada-Bo", "a-1", "li-na")] == [
        *("Viktor Axelsen", "club", "Ada-Bo", "a-1", "Li Na")
    ]
    assert say.event("Viktor_AXELSEN_Kento_MOMOTA_Open_2020_Final", ("viktor-axelsen", "kento-momota")) == "Open 2020 Final"
    assert (say.capital("a smash"), say.capital("")) == ("A smash", "")
    assert [say.shot("smash", form) for form in (0, 1, 2, 9)] == ["smash", "a smash", "smashes", "smashes"]


def place(difference: Estimate, mean: Estimate = UNKNOWN, clear: bool = True) -> Place:
    return Place(mean=mean, difference=difference, p=0.01, clear=clear)


def wait(player: int, shot: str, depth: Estimate, side: Estimate, *, clear: bool = True, mean: Estimate = UNKNOWN) -> Wait:
    positions = (0.1, 0.0, 0.2, 0.0, 0.4, 0.0, 0.0, 0.3, 0.0)
    return Wait(
        player=player, shot=shot, strokes=50, others=60, positions=positions, depth=place(depth, mean, clear), side=place(side)
    )


def test_differences_of_where_players_wait_are_named_with_their_sizes() -> None:
    near, wide = Estimate(-0.25, -0.4, -0.125), Estimate(0.5, 0.375, 0.625)
    found = differences([wait(0, "smash", near, wide), wait(1, "smash", near, wide), wait(1, "lift", near, wide)], match=False)
    assert [(each.wait.player, each.kind, each.value, each.low, each.high) for each in found] == [
        *((player, "forehand", 0.5, 0.375, 0.625) for player in (0, 1, 1)),
        *((player, "closer", 0.25, 0.125, 0.4) for player in (0, 1, 1)),
    ]
    # In a match the difference of one is that of the other.
    one = differences([wait(0, "smash", near, wide), wait(1, "smash", near, wide), wait(1, "lift", near, wide)], match=True)
    assert [(each.wait.player, each.wait.shot) for each in one] == [(0, "smash"), (1, "lift")] * 2
    turned = differences([wait(0, "smash", wide, near)], match=True)
    assert [each.kind for each in turned] == ["farther", "backhand"]
    assert shown_differences(wait(0, "smash", near, wide)) == "0.25 m closer to the net, 0.50 m more to the forehand side"
    unclear = dataclasses.replace(wait(0, "smash", near, wide, clear=False), side=place(wide, clear=False))
    assert shown_differences(unclear) == "no difference shown"
    assert differences([unclear], match=False) == []


def test_distances_and_shares_of_positions() -> None:
    sure = wait(0, "smash", UNKNOWN, UNKNOWN, mean=Estimate(3.5, 3.25, 3.75))
    assert distance(sure) == "3.50 (3.25 to 3.75)"
    assert distance(wait(0, "smash", UNKNOWN, UNKNOWN, mean=Estimate(3.5, NAN, NAN))) == "3.50"
    # Rows of three are depths: .1 + .2, .4, .3; columns are sides: .1, .4 + .3, .2.
    assert shares(sure, 1) == "30 / 40 / 30"
    assert shares(sure, 0) == "10 / 70 / 20"


def test_drills_are_the_first_three_of_different_kinds() -> None:
    asked = [Drill("lift", 1, stroke, kind) for stroke, kind in ((1, 5), (2, 5), (3, 6), (4, 7), (5, 7), (6, 8), (7, 5))]
    assert [drill.stroke for drill in drills(asked)] == [1, 3, 4]
    assert drills(asked[:2]) == asked[:1]
    assert drills([]) == []


def row(game: int, winner: int | None, before: float, strokes: int = 3, **fields: Any) -> SimpleNamespace:
    return SimpleNamespace(key=(game, 1), winner=winner, before=before, after=before / 2, strokes=strokes, **fields)


def test_the_course_of_a_match() -> None:
    rows = [row(1, 0, 0.5), row(1, None, 0.6), row(2, 1, 0.7), row(3, 0, 0.8)]
    report: Any = SimpleNamespace(rallies=rows, score=((21, 9), (9, 21), (22, 20)), rules=BWF)
    found = match_pages._course(report)
    assert (found["winner"], found["won"], found["ends"], found["played"]) == (0, [2, 1], [2, 3], 102)
    assert (found["chance"], found["cut"]) == ([0.5, 0.6, 0.7, 0.8, 0.4], [])
    report.score = ((9, 21), (11, 20), (3, 21), (0, 0))
    found = match_pages._course(report)
    assert (found["winner"], found["cut"]) == (1, [2, 4]), "game 2 is cut off, and there is a fourth"
    report.score = ((21, 9), (9, 21), (20, 21))
    found = match_pages._course(report)
    assert (found["winner"], found["cut"]) == (1, [3])
    report.score, report.rules = ((21, 9), (9, 15)), Rules(games=3)
    assert (match_pages._course(report)["winner"], match_pages._course(report)["cut"]) == (None, [])


def test_bars_and_drills_of_a_match() -> None:
    value: Any = SimpleNamespace(player=1, shot="smash", points=Estimate(2.0, 1.0, 3.0), clear=False)
    report: Any = SimpleNamespace(players=("Ada", "B" * 30))
    assert match_pages._bar(report, value) == Bar(f"{'B' * 24}: smashes", 2.0, 1.0, 3.0, clear=False, player=1)
    shots, areas = np.array([10, 11, 12]), np.array([3, 4, 5])
    catalogue = SimpleNamespace(names=("a", "b", "c"), shot=shots, area=areas)
    choices = [SimpleNamespace(player=p, incoming=i, better=b) for p, i, b in ((0, 3, 1), (1, 0, 2), (0, 2, 0))]
    report = SimpleNamespace(game=SimpleNamespace(catalogue=catalogue), choices=choices)
    assert match_pages._drills(report, 0) == [Drill(None, -1, 1, 11), Drill(SHOTS[12], 5, 0, 10)]
    assert match_pages._drills(report, 1) == [Drill(SHOTS[10], 3, 2, 12)]


def ending(shot: str, technique: str | None, fault: bool, winner: bool) -> Ending:
    return Ending(
        shot=shot,
        technique=technique,
        strokes=50,
        fault=(0.1, 0.05, 0.2, 0.1),
        winner=(0.1, 0.05, 0.2, 0.1),
        clear=(fault, winner),
    )


def test_what_holds_of_a_shot_type_is_not_said_again_of_its_techniques() -> None:
    found = [
        ending("smash", None, True, False), ending("smash", "forehand", True, True), ending("lift", None, False, False),
        ending("lift", "backhand", True, False), ending("drop", "forehand", False, False),
    ]  # fmt: skip
    clear = [(each.shot, each.technique, end) for each, end in scout_pages._clear_endings(found)]
    assert clear == [("smash", None, "fault"), ("smash", "forehand", "winner"), ("lift", "backhand", "fault")]


def habit(kind: str, about: str, share: float, usual: float = 0.0, clear: bool = False) -> Habit:
    figures = {"strokes": 50, "share": share, "low": 0, "high": 1, "usual": usual, "p": 0.5}
    return Habit(kind=kind, about=(about,), answer="smash", clear=clear, **figures)


def test_answers_that_are_not_rare_are_listed_by_question() -> None:
    habits = [
        habit("third", "a", 0.5), habit("shots", "b", 0.02), habit("shots", "a", 0.019, 0.02), habit("shots", "a", 0.6),
        habit("shots", "a", 0.019, 0.019), habit("serve", "a", 0.9),
    ]  # fmt: skip
    report: Any = SimpleNamespace(habits=habits)
    found = scout_pages._answers(report, ("shots", "third"))
    assert [(each.kind, each.about[0], each.share) for each in found] == [
        *(("shots", "a", 0.6), ("shots", "a", 0.019), ("shots", "b", 0.02), ("third", "a", 0.5))
    ]


def test_another_opponent_stands_beside_with_the_number_of_differences() -> None:
    assert scout_pages._beside(cast(Any, SimpleNamespace(beside=None))) is None
    habits = [habit("shots", "a", 0.5, clear=True), habit("targets", "a", 0.5, clear=True), habit("serve", "a", 0.01, clear=True)]
    habits += [habit("return", "a", 0.3), habit("third", "a", 0.3)]
    found = scout_pages._beside(cast(Any, SimpleNamespace(beside=("kento-momota", habits))))
    assert found == {"name": "Kento Momota", "differ": 2, "tested": 4, "habits": [habits[0], habits[3], habits[4]]}


def test_advised_strokes_are_drills() -> None:
    advice = [SimpleNamespace(situation=(shot, area, 9), stroke=stroke) for shot, area, stroke in ((-1, -1, 0), (2, 5, 1))]
    pair = SimpleNamespace(catalogue=SimpleNamespace(shot=np.array([7, 8])))
    found = scout_pages._drills(cast(Any, SimpleNamespace(pair=pair, advice=advice)))
    assert found == [Drill(None, -1, 0, 7), Drill(SHOTS[2], 5, 1, 8)]
    assert scout_pages._drills(cast(Any, SimpleNamespace(pair=None, advice=advice))) == []


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


def test_examples_are_left_out_when_they_are_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examples, "_MOST_BYTES", 25)
    monkeypatch.setattr(examples, "stage", lambda rally, **_: SimpleNamespace(pack=lambda first: f"{rally.name} {first}"))
    monkeypatch.setattr(examples, "rally_facts", lambda *_: None)
    monkeypatch.setattr(examples, "hall_facts", lambda: None)
    monkeypatch.setattr(examples, "model_file", lambda name: SimpleNamespace(read_bytes=lambda: name))
    monkeypatch.setattr(examples, "StrokeValues", lambda _: SimpleNamespace(analysis=lambda *_: "analysis"))
    monkeypatch.setattr(examples, "PolicyTables", lambda game: game)
    monkeypatch.setattr("shuttle_marl.watch.messages.encode_reply", lambda number, reply, parts=(): (number, reply, parts))

    def packed(content: Any) -> str:
        return content if isinstance(content, str) else "x" * 10 if content[2] else f"{type(content[1]).__name__}"

    monkeypatch.setattr(examples, "_packed", packed)
    rallies: Any = [
        SimpleNamespace(name=name, key=1, athletes=("male", look))
        for name, look in zip("abc", ("male", "female", "x"), strict=True)
    ]
    content, count = examples.shared(rallies, cast(Any, SimpleNamespace(hash="0123456789abcdef")), cast(Any, None))
    found = json.loads(content)
    assert count == 2, "30 bytes would be too many"
    assert found["replies"] == {"rally 0": "x" * 10, "analysis 0": "str", "rally 1": "x" * 10, "analysis 1": "str"}
    assert found["models"] == {"male": "male", "female": "female"}
    monkeypatch.setattr(examples, "_MOST_BYTES", 20)
    assert examples.shared(rallies, cast(Any, SimpleNamespace(hash="0")), cast(Any, None))[1] == 2, "20 are not"


class Played:
    """A simulated rally: the states in which seat 0 strikes, at its even strokes."""

    def __init__(self, states: list[int]) -> None:
        self.found, self.striker = states, [i % 2 for i in range(len(states))]

    def states(self, _: object) -> np.ndarray:
        return np.array(self.found)


def test_an_example_of_advice_is_one_in_which_its_situation_comes_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    rallies = {0: [9] * 7 + [5], 1: [9] * 8 + [5], 2: [9] * 6 + [15], 3: [9, 9, 5, 9, 5], 4: [5]}
    played: list[tuple[int, dict[int, int]]] = []

    def play(pair: object, policies: object, key: int, about: Any, chosen: dict[int, int]) -> Any:
        played.append((key, chosen))
        if chosen:
            return (key, about[0], about[2].server, chosen)
        return Played(rallies.get(key, [9]))

    monkeypatch.setattr(examples, "play_rally", play)
    monkeypatch.setattr(examples, "stream", lambda *numbers: numbers[-1])
    monkeypatch.setattr(examples, "_ATTEMPTS", 10)
    monkeypatch.setattr(examples, "looks_of", lambda *_: SimpleNamespace(_asdict=dict))
    monkeypatch.setattr("dataclasses.replace", lambda rally, **looks: rally)
    pair: Any = SimpleNamespace(n_base_states=10)
    advice: Any = SimpleNamespace(states=np.array([5]), stroke=77)
    # Seat 0 strikes in state 5 (and 15 at another effort) as stroke 8 of rally 1, 6 of rally 2, and 2 of rally 3.
    found = examples.staged_advice([advice, advice], pair, cast(Any, SimpleNamespace(policies=())), ("a", "b"))
    assert found == [(3, 0, 1, {2: 77}), (3, 1, 1, {2: 77})]
    assert [key for key, chosen in played if not chosen] == [0, 1, 2, 3], "no rally is played twice"
    nothing: Any = SimpleNamespace(states=np.array([4]), stroke=77)
    with pytest.raises(ShuttleError, match="advice 2: no example in 10 rallies"):
        examples.staged_advice([advice, nothing], pair, cast(Any, SimpleNamespace(policies=())), ("a", "b"))


def test_addresses_of_videos_have_the_seconds_once() -> None:
    assert sources.video_of("https://v.example/x?t={seconds}s")(61.9) == "https://v.example/x?t=61s"
    assert sources.video_of("http://v.example/#{seconds}")(0.0) == "http://v.example/#0"
    for wrong in (
        "https://v.example",
        "https://v.example/{seconds}/{seconds}",
        "https://v.example/{minutes}",
        "ftp://v/{seconds}",
        "{seconds}",
    ):
        with pytest.raises(AnalysisError, match=r"expected an http or https address with \{seconds\} once"):
            sources.video_of(wrong)


def test_options_of_the_other_kind_of_file_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr(sources, "is_log", lambda path: path.suffix == ".mcap")
    monkeypatch.setattr(sources, "of_log", lambda *about: asked.append(about))
    monkeypatch.setattr(sources, "of_strokes", lambda *about: asked.append(about))
    log, table, game = Path("a.mcap"), Path("a.csv"), cast(Any, "game")
    sources.of_file(log, game, "12", pairing=3)
    sources.of_file(log, game)
    sources.of_file(table, game, "final", columns=Path("map.toml"))
    assert asked == [(log, game, 3, 12), (log, game, 0, 0), (table, game, "final", Path("map.toml"))]
    for path, match, options, says in (
        (table, None, {"pairing": 1}, "--pairing 1: only rally logs have pairings"),
        (log, None, {"columns": table}, "is a rally log, which has no columns"),
        (log, "final", {}, "--match final: expected the number of a match"),
        (log, "-1", {}, "expected the number of a match"),
    ):
        with pytest.raises(ShuttleError, match=says):
            sources.of_file(path, game, match, **cast(Any, options))
    assert len(asked) == 3


def test_cells_of_tables() -> None:
    assert number(1.25, "+.1f") == Cell("+1.2", 1.25)
    assert (number(NAN, ".1f"), percent(NAN), interval(NAN, NAN, ".1f")) == (Cell(), Cell(), Cell())
    assert (percent(0.1234), percent(0.1234, 0), percent(-0.0001)) == (
        Cell("12.3 %", 0.1234),
        Cell("12 %", 0.1234),
        Cell("0.0 %", -0.0001),
    )
    assert interval(-1.0, 2.5, "+.1f") == Cell("-1.0 to +2.5", 3.5)
    assert name("Ada") == Cell("Ada", "ada")


def test_long_names_are_shortened_and_wide_letters_counted() -> None:
    assert drawings.label("x" * 26) == "x" * 26
    assert drawings.label("x" * 27) == "x" * 25 + "…"
    assert drawings.label("abcd", 3) == "ab…"
    assert charts._wide("a杀球b") == 2
