"""Tagging of a video: the reducer of the page, suggestions, what is saved, and what the reports read."""

import contextvars
import errno
import functools
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from shuttle_marl.base.files import seal
from shuttle_marl.base.runs import RunError
from shuttle_marl.commands.watch import TagOptions
from shuttle_marl.court import WatchError
from shuttle_marl.court.messages import SHOWN, Saved, TagRequest, TagRow, TagStroke
from shuttle_marl.court.tagging import TagFile, suggestions
from shuttle_marl.court.values import hall_facts
from shuttle_marl.data import read_matches
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import REASONS, violations
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS, HANDS
from shuttle_marl.game.scoring import RULES, RulesName
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.policy.registry import resolve
from tests.watch.conftest import Viewer, get, run_script, running, serving

SETUP: dict[str, Any] = {
    "kind": "setup", "match": "club", "discipline": "WS", "players": ["Ada", "Bea"], "hands": [None, "left"], "server": 0,
    "rules": "21",
}  # fmt: skip
CLICKS = ((0.1, 0.9), (0.9, 0.9), (0.7, 0.2), (0.3, 0.2))


def corners(*clicks: tuple[float, float]) -> list[dict[str, Any]]:
    return [{"kind": "corner", "x": x, "y": y} for x, y in clicks]


CORNERS: list[dict[str, Any]] = [*corners(*CLICKS), {"kind": "confirm"}]


def shot(name: str, time: float, technique: int = 0, height: int = 0, **known: Any) -> dict[str, Any]:
    fields = {"time": time, "technique": technique, "height": height, "probability": None, "areas": None, **known}
    return {"kind": "shot", "shot": SHOTS.index(name), **fields}


def cell(number: int) -> dict[str, Any]:
    return {"kind": "cell", "cell": number, "time": 0.0}


def end(ending: str) -> dict[str, Any]:
    return {"kind": "end", "ending": ending}


def tagged(folder: Path, inputs: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page makes of inputs."""
    (folder / "hall.json").write_bytes(msgspec.json.encode(hall_facts()))
    (folder / "inputs.json").write_text(json.dumps(inputs))
    found: dict[str, Any] = json.loads(run_script("tag.ts", str(folder / "hall.json"), str(folder / "inputs.json")))
    assert found["same"], "the state follows from the inputs"
    return found


def test_the_page_judges_scores_as_the_game_does() -> None:
    scores = Path(__file__).parents[1] / "game" / "scores.json"
    found = json.loads(run_script("scores.ts", str(scores)))
    assert found == [won for *_, won in json.loads(scores.read_text(encoding="utf-8"))["games"]]


RALLY = [
    SETUP, shot("short-serve", 1.0, 1), cell(7), shot("lift", 1.8), cell(1), shot("smash", 3.0, 2, 1), cell(6), end("landed"),
]  # fmt: skip


def test_two_inputs_a_stroke_and_the_rules_tell_the_rest(tmp_path: Path) -> None:
    found = tagged(tmp_path, RALLY)
    assert found["refused"] == []
    rows = found["rows"]
    assert [SHOTS[row["shot"]] for row in rows] == ["short-serve", "lift", "smash"]
    assert [(row["player"], row["hand"]) for row in rows] == [("Ada", None), ("Bea", "left"), ("Ada", None)]
    # Ada is near: the top row of the keypad is the back of Bea's half, and the picture's left is Bea's right.
    assert [AREAS[row["area"]] for row in rows] == ["back-right", "back-left", "middle-left"]
    assert [(row["ending"], row["winner"], row["points"], row["points_opponent"]) for row in rows] == [
        (None, "Ada", 1, 0), (None, "Ada", 0, 1), ("landed", "Ada", 1, 0),
    ]  # fmt: skip
    assert found["last"]["points"] == [1, 0]
    assert found["last"]["server"] == 0


@pytest.mark.parametrize(
    ("inputs", "reason"),
    [
        ([SETUP, shot("short-serve", 1), shot("lift", 2)], "Shot keys sleep"),
        ([SETUP, shot("smash", 1)], "begins with a serve"),
        ([SETUP, shot("short-serve", 1), cell(7), shot("long-serve", 2)], "how did this one end"),
        ([SETUP, shot("short-serve", 2), cell(7), shot("lift", 1)], "not after the last stroke"),
        ([SETUP, shot("short-serve", 2), end("landed")], "where did it fall"),
        ([SETUP, shot("short-serve", 2), {"kind": "place", "x": 0.5, "y": 0.5, "time": 1.5}], "click the four corners"),
        ([{**SETUP, "players": ["Ada", "Ada"]}], "different names"),
        ([SETUP, *corners((0.9, 0.9), (0.1, 0.9))], "not the near right corner"),
        ([SETUP, *corners((0.3, 0.2), (0.7, 0.2), (0.9, 0.9))], "not the far right corner: near corners lie lower"),
        ([SETUP, *corners(*CLICKS[:2], (0.3, 0.2), (0.7, 0.2))], "not the far left corner"),
        ([SETUP, *corners(*CLICKS[:2], (0.7, 0.2), (0.8, 0.55))], "not the far left corner"),
        ([SETUP, *corners((0.1, 0.9), (0.5, 0.5), (0.9, 0.1))], "not the far right corner"),
    ],
)
def test_impossible_inputs_are_refused_and_change_nothing(inputs: list[dict[str, Any]], reason: str, tmp_path: Path) -> None:
    found = tagged(tmp_path, inputs)
    assert len(found["refused"]) == 1
    assert reason in found["refused"][0]
    assert found["phases"][-1] == ([*found["phases"], "setup"][-3] if len(inputs) > 1 else "setup")


def test_improbable_inputs_are_asked_once(tmp_path: Path) -> None:
    rare = [SETUP, shot("short-serve", 1), cell(7), shot("net-kill", 2, probability=0.0001)]
    found = tagged(tmp_path, rare)
    assert found["phases"][-1] == "ask"
    assert "hardly ever" in found["question"]
    assert tagged(tmp_path, [*rare, cell(5), {"kind": "confirm"}, cell(5)])["phases"][-3:] == ["ask", "place", "shot"]
    shares = [0.5, 0.4, 0.09, *[0.0] * 6]  # a block goes to the front
    block = [SETUP, shot("short-serve", 1), cell(7), shot("lift", 2), cell(2), shot("block", 3, areas=shares)]
    assert tagged(tmp_path, [*block, cell(8)])["question"] == "A block to back centre is hardly ever played."
    assert tagged(tmp_path, [*block, cell(2)])["phases"][-1] == "shot"
    wrong_court = tagged(tmp_path, [SETUP, shot("short-serve", 1), cell(9)])
    assert "right service court" in wrong_court["question"]
    for y, ending, asks in ((-0.3, "landed", True), (-0.3, "out", False), (0.1, "out", True)):
        found = tagged(
            tmp_path,
            [SETUP, *CORNERS, shot("long-serve", 1), {"kind": "place", "x": 0.5, "y": 0.2 + y, "time": 1.5}, end(ending)],
        )
        assert found["refused"] == []
        assert found["phases"][-1] == ("ask" if asks else "shot")


def test_places_of_clicks_are_metres(tmp_path: Path) -> None:
    inputs = [SETUP, *CORNERS, shot("short-serve", 1), {"kind": "place", "x": 0.5, "y": 0.3, "time": 1.5}, shot("lift", 2),
              {"kind": "place", "x": 0.1, "y": 0.9, "time": 1.5}]  # fmt: skip
    found = tagged(tmp_path, inputs)
    u, v = 0.5, 0.4
    clicks = np.array(CLICKS)
    goal = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    lines = [[x, y, 1, 0, 0, 0, -x * a, -y * a] for (x, y), (a, _) in zip(clicks, goal, strict=True)]
    lines += [[0, 0, 0, x, y, 1, -x * b, -y * b] for (x, y), (_, b) in zip(clicks, goal, strict=True)]
    h = np.append(np.linalg.solve(lines, [*goal[:, 0], *goal[:, 1]]), 1).reshape(3, 3) @ [u, v, 1]
    assert np.allclose(found["middle"], h[:2] / h[2])
    serve, lift = found["rows"]
    assert abs(serve["landing_x"]) < 1e-3
    assert serve["landing_y"] > 0
    # Bea strikes from the far side, so her left and right are those of the picture mirrored.
    assert (lift["landing_x"], lift["landing_y"]) == (3.05, 6.7)
    assert (lift["contact_x"], lift["contact_y"]) == (-serve["landing_x"], -serve["landing_y"])


@pytest.mark.parametrize("name", ["21", "15", "11"])
def test_the_score_serves_and_changes_ends(name: RulesName, tmp_path: Path) -> None:
    inputs: list[dict[str, Any]] = [SETUP | {"rules": name}]
    points, games = RULES[name].points, RULES[name].games
    for number in range(games * points):
        near = number // points % 2 == 0  # ends change after every game
        right = number % points % 2 == 0
        inputs += [shot("long-serve", number), cell((7 if right else 9) if near else (3 if right else 1)), end("landed")]
    found = tagged(tmp_path, inputs)
    assert found["refused"] == []
    assert found["phases"][-1] == "over"
    assert found["games"] == [games, 0]
    assert found["near"] == (games - 1) % 2
    assert [(row["game"], row["rally"]) for row in found["rows"]] == [(g + 1, r + 1) for g in range(games) for r in range(points)]
    assert {row["rules"] for row in found["rows"]} == {name}
    assert {AREAS[row["area"]] for row in found["rows"]} == {"back-right", "back-left"}


def test_time_without_play_is_skipped(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def asked(*parts: tuple[float, float], start: float, within: float = 3.0) -> float | None:
        """Time at which playback resumes; parts are seconds and motion, and the first is a known rally."""
        motion = np.concatenate([rng.normal(level, 0.3 * level, int(4 * seconds)).clip(0) for seconds, level in parts])
        given = {"motion": motion.tolist(), "rallies": [{"from": 0, "to": parts[0][0]}], "from": start, "within": within}
        (tmp_path / "given.json").write_text(json.dumps(given))
        return json.loads(run_script("dead.ts", str(tmp_path / "given.json")))

    to = asked((10, 1.0), (60, 0.2), (10, 1.0), start=10)
    assert to is not None
    assert 66 <= to <= 69
    assert asked((10, 1.0), (60, 0.2), start=10) is None, "the next rally has not been found yet"
    assert asked((10, 1.0), (2, 0.2), (10, 1.0), start=10) is None, "not worth a jump"
    assert asked((10, 1.0), (10, 1.0), (60, 0.2), (10, 1.0), start=10) is None, "another rally is not skipped"
    assert asked((10, 1.0), (10, 1.0), (60, 0.2), (10, 1.0), start=10, within=60) is not None
    assert asked((10, 1.0), (3, 0.2), (2, 1.0), (20, 0.2), (10, 1.0), start=10) is None, "a serve and its return are a rally"


def test_a_let_is_replayed_without_a_point(tmp_path: Path) -> None:
    serve = [shot("short-serve", 9.0, 1), cell(9)]  # Ada, who has a point, serves from the left
    found = tagged(tmp_path, [*RALLY, *serve, shot("lift", 9.9), end("let"), *serve, shot("lift", 11.0), cell(1), end("out")])
    assert found["refused"] == []
    assert [(row["rally"], row["ending"], row["winner"], row["points"]) for row in found["rows"][3:]] == [
        (2, None, None, None), (2, "let", None, None), (3, None, "Ada", 2), (3, "out", "Ada", 0),
    ]  # fmt: skip
    assert (found["last"]["points"], found["last"]["server"]) == ([2, 0], 0)
    file = TagFile(Path(__file__), tmp_path / "match.csv")
    save(file, "{}", requests(found["rows"]))
    cleaned = import_matches(tmp_path / "match.csv")
    assert (cleaned.account.dropped, cleaned.warnings) == ({"let": 2}, ())
    assert cleaned.strokes["rally"].to_pylist() == [1, 1, 1, 2, 2]


def test_suggestions_are_shares_of_the_policy() -> None:
    game = default_game()
    policy = resolve("bc", game)
    serves = suggestions(game, policy, [])
    assert {SHOTS[one.shot] for one in serves[:2]} == {"short-serve", "long-serve"}
    assert sum(one.probability for one in serves) == pytest.approx(1)
    line = [TagStroke(shot=SHOTS.index("short-serve"), technique=1, height=0, area=1)]
    lifted = [*line, TagStroke(shot=SHOTS.index("lift"), technique=0, height=0, area=8)]
    replies = suggestions(game, policy, lifted)
    assert sum(one.probability for one in replies) == pytest.approx(1)
    assert [one.probability for one in replies] == sorted((one.probability for one in replies), reverse=True)
    assert {SHOTS[one.shot] for one in replies[:4]} == {"clear", "drop", "smash", "half-smash"}
    assert [sorted(one.ways) for one in replies] == [list(range(len(TECHNIQUES) * len(HEIGHTS)))] * len(SHOTS)
    assert [HEIGHTS[one.ways[0] % 2] for one in replies[:4]] == ["above"] * 4
    smash = TagStroke(shot=SHOTS.index("smash"), technique=0, height=1, area=4)
    (block,) = [one for one in suggestions(game, policy, [*line, smash]) if SHOTS[one.shot] == "block"]
    assert sum(block.areas) == pytest.approx(1, abs=1e-4)
    assert sum(block.areas[6:]) < 0.005, "no block goes to the back"
    mirrored = [*line, TagStroke(shot=SHOTS.index("lift"), technique=0, height=0, area=6)]
    assert suggestions(game, policy, mirrored, ("right", "left")) == replies != suggestions(game, policy, mirrored)
    assert suggestions(game, policy, lifted * 1 + [TagStroke(shot=SHOTS.index("drop"), technique=0, height=1, area=None)])


def save(file: TagFile, entered: str | None, rows: Sequence[TagRow] = (), first: int = 0, **options: Any) -> Saved:
    """Save an input as a page does that shows what is saved."""
    if "at" not in options:
        options = {"after": file.facts().after, "at": len(file.facts().inputs)} | options
    return file.save(TagRequest(id=1, input=entered, first=first, rows=tuple(rows), **options))


def requests(rows: list[dict[str, Any]]) -> list[TagRow]:
    return [msgspec.convert(row, TagRow) for row in rows]


NO_ROW = dict.fromkeys(TagRow.__struct_fields__) | {
    "shot": 0, "technique": 0, "height": 0, "match": "club", "discipline": "WS", "rules": "21", "game": 1, "rally": 1,
    "stroke": 1, "opponent": "Bea", "seconds": 1.0, "frame": 30,
}  # fmt: skip


def test_what_is_saved_is_read_by_import_and_tagging_continues(tmp_path: Path) -> None:
    video, out = tmp_path / "match.webm", tmp_path / "strokes" / "match.csv"
    video.write_bytes(b"film")
    rows = requests(tagged(tmp_path, RALLY)["rows"])
    file = TagFile(video, out)
    for at, one in enumerate(RALLY):
        after, told = file.facts().after, rows if at == len(RALLY) - 1 else ()
        saved = save(file, json.dumps(one), told)
        repeated = save(file, json.dumps(one), told, after=after)
        assert repeated == saved, "a repeated request is answered, and kept once"
        assert saved.inputs == at + 1
    cleaned = import_matches(out)
    strokes = cleaned.strokes
    assert list(violations(strokes)) == []
    assert cleaned.warnings == ()
    assert [SHOTS[code] for code in strokes["shot"].to_pylist()] == ["short-serve", "lift", "smash"]
    assert [TECHNIQUES[code] for code in strokes["technique"].to_pylist()] == ["backhand", "forehand", "around-the-head"]
    assert strokes["hand"].to_pylist() == [None, HANDS.index("left"), None]
    assert [REASONS[code] for code in strokes["reason"].to_pylist()] == ["returned", "returned", "landed"]
    assert strokes["frame"].to_pylist() == [30, 54, 90]
    file.close()
    again = TagFile(video, out)
    assert [json.loads(text) for text in again.facts().inputs] == RALLY
    assert again.facts().rows == 3
    save(again, None, first=2)
    assert out.read_text().count("\n") == 3


def tag_file(folder: Path, name: str = "match") -> TagFile:
    (folder / "match.webm").write_bytes(b"film")
    return TagFile(folder / "match.webm", folder / f"{name}.csv")


class Tagging(RuleBasedStateMachine):
    """A journal beside the list of the inputs that it has to hold."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.file = tag_file(self.folder)
        self.inputs: list[str] = []
        self.number = 0
        self.stale: list[tuple[str, list[str]]] = []
        """What pages showed: the hash that the server told, and the inputs."""
        self.last: tuple[str | None, str] | None = None
        """The last change, and the hash before it."""

    def teardown(self) -> None:
        self.file.close()
        shutil.rmtree(self.folder)

    def change(self, entered: str | None) -> None:
        before = self.file.facts().after
        self.stale.append((before, [*self.inputs]))
        saved = save(self.file, entered)
        self.inputs = [*self.inputs, entered] if entered is not None else self.inputs[:-1]
        assert saved.inputs == len(self.inputs)
        self.last = entered, before

    @rule()
    def enter(self) -> None:
        self.number += 1
        self.change(f"[{self.number}]")

    @rule()
    def undo(self) -> None:
        self.change(None)

    @precondition(lambda self: self.last)
    @rule()
    def repeat(self) -> None:
        """A page that got no answer asks again; it is answered, and nothing changes."""
        entered, before = self.last
        assert save(self.file, entered, after=before).inputs == len(self.inputs) or before == self.file.facts().after

    @precondition(lambda self: self.stale)
    @rule(data=st.data(), entered=st.sampled_from(["[0]", None]))
    def another_page(self, data: st.DataObject, entered: str | None) -> None:
        """A page that shows other inputs is refused, even if it shows as many."""
        after, shown = data.draw(st.sampled_from(self.stale))
        if shown != self.inputs and (entered, after) != self.last:
            with pytest.raises(WatchError, match="another page has changed the strokes; load this page again"):
                save(self.file, entered, after=after)

    @rule(tail=st.sampled_from([b"", b"{", b'{"input": "[9]"', b"\xff"]))
    def restart(self, tail: bytes) -> None:
        """After a process that was killed while it wrote a line."""
        self.file.close()
        with (self.folder / "match.inputs.jsonl").open("ab") as journal:
            journal.write(tail)
        self.file = tag_file(self.folder)

    @invariant()
    def holds_the_inputs(self) -> None:
        assert self.file.facts().inputs == self.inputs


TestTagging = Tagging.TestCase
TestTagging.settings = settings(max_examples=20, stateful_step_count=25, deadline=None)


def test_a_connection_remembers_what_its_page_shows(tmp_path: Path) -> None:
    file = tag_file(tmp_path)
    one, other = contextvars.Context(), contextvars.Context()
    for page in (one, other):
        page.run(SHOWN.set, [])
    for number in range(2):
        one.run(save, file, f"[{number}]", at=number)
    other.run(file.facts)
    one.run(save, file, None, at=2)
    one.run(save, file, "[2]", at=1)
    with pytest.raises(WatchError, match="another page"):
        other.run(save, file, "[3]", at=2)
    other.run(file.facts)
    assert other.run(save, file, "[3]", at=2).inputs == 3


def test_a_second_server_is_refused_with_the_number_of_the_first(tmp_path: Path) -> None:
    file = tag_file(tmp_path)
    with pytest.raises(
        RunError, match=rf"match.csv: another process \({os.getpid()}\) runs there; wait for it, end it, or name another"
    ):
        tag_file(tmp_path)
    tag_file(tmp_path, "other").close()
    file.close()
    tag_file(tmp_path).close()


@pytest.mark.parametrize("written", [0, 1, 20])
def test_after_a_full_disk_tagging_continues(tmp_path: Path, written: int, monkeypatch: pytest.MonkeyPatch) -> None:
    file, real = tag_file(tmp_path), os.fsync
    for number in range(3):
        save(file, f"[{number}]")
    journal = tmp_path / "match.inputs.jsonl"
    whole = journal.read_bytes()
    with monkeypatch.context() as full:

        def fails(handle: int) -> None:
            os.ftruncate(handle, len(whole) + written)
            raise OSError(errno.ENOSPC, "No space left on device")

        full.setattr(os, "fsync", fails)
        with pytest.raises(RunError, match=r"No space left on device.; free disk space and enter the next input"):
            save(file, "[3]")
    assert file.facts().inputs == ["[0]", "[1]", "[2]"]
    assert journal.read_bytes() == whole
    assert os.fsync is real
    save(file, "[4]")
    file.close()
    assert tag_file(tmp_path).facts().inputs == ["[0]", "[1]", "[2]", "[4]"]


def test_other_rules_do_not_continue_the_strokes(tmp_path: Path) -> None:
    file = tag_file(tmp_path)
    save(file, json.dumps(SETUP | {"rules": "15"}))
    file.close()
    with pytest.raises(WatchError, match=r"--rules 21: .*match.csv was begun by the rules 15; continue it without --rules"):
        TagFile(tmp_path / "match.webm", tmp_path / "match.csv", "21")
    TagFile(tmp_path / "match.webm", tmp_path / "match.csv", "15").close()


def test_another_film_does_not_continue_the_strokes(tmp_path: Path) -> None:
    file = tag_file(tmp_path)
    save(file, "[0]")
    file.close()
    (tmp_path / "other.webm").write_bytes(bytes(5000))
    with pytest.raises(WatchError, match=r"of the film 'match.webm' of 4 bytes, not of .*other.webm of 5,000"):
        TagFile(tmp_path / "other.webm", tmp_path / "match.csv")
    assert tag_file(tmp_path).facts().inputs == ["[0]"]


def test_a_journal_of_another_kind_is_refused(tmp_path: Path) -> None:
    journal = tmp_path / "match.inputs.jsonl"
    journal.write_bytes(seal({"input": 3}, indent=None))
    with pytest.raises(WatchError, match=r"3 is no input; move it away, and match.csv too, and begin again"):
        tag_file(tmp_path)
    journal.write_bytes(b"x\n")
    with pytest.raises(RunError, match=r"line 1 is damaged .*; move it away, and match.csv too"):
        tag_file(tmp_path)
    with journal.open("wb") as file:
        file.truncate(1_500_000_000)
    with pytest.raises(RunError, match="larger than 32 MB"):
        tag_file(tmp_path)


NAMES = {
    "Ada Alpha": True, "Müller, Jörg": True, "李娜": True, "a" * 100: True, "a" * 101: False, "": False,
    "=1": False, " =1": False, "\t=1": False, "+x": False, "-x": False, "@x": False, "Anna\tExample": False,
    "a\u2028b": False,
    "a\u200bb": False, "a\x85b": False, " Ada": False, "a-b=c+d@e": True,
}  # fmt: skip


@functools.cache
def names_that_the_form_takes(pattern: str) -> list[bool] | None:
    """Matches of the pattern in each name by a JavaScript engine, if one is installed."""
    test = f"(name) => new RegExp('^(?:' + {json.dumps(pattern)} + ')$', 'v').test(name)"
    script = f"process.stdout.write(JSON.stringify({json.dumps([*NAMES])}.map({test})))"
    node = shutil.which("node")
    return json.loads(subprocess.run([node, "-e", script], capture_output=True, check=True).stdout) if node else None


@pytest.mark.parametrize(("name", "fine"), NAMES.items())
def test_the_form_takes_what_the_server_takes(name: str, fine: bool, tmp_path: Path) -> None:
    facts = tag_file(tmp_path).facts()
    assert ((len(name) <= facts.longest_name) and re.search(facts.name, name) is not None) == fine
    taken = names_that_the_form_takes(facts.name)
    if taken and len(name) <= facts.longest_name:
        assert taken[[*NAMES].index(name)] == fine
    try:
        requests([{**NO_ROW, "player": name}])
    except msgspec.ValidationError:
        assert not fine
    else:
        assert fine


def test_a_table_that_a_spreadsheet_saved(tmp_path: Path) -> None:
    video, out = tmp_path / "match.webm", tmp_path / "match.csv"
    video.write_bytes(b"film")
    (row,) = requests([{**NO_ROW, "player": "Müller J"}])
    file = TagFile(video, out)
    save(file, "{}", (row,))
    file.close()
    saved = out.read_text(encoding="utf-8")
    for content in (saved.encode(), saved.replace("\n", "\r\n").encode("utf-8-sig")):
        out.write_bytes(content)
        file = TagFile(video, out)
        save(file, None, (row,), first=1, only_rows=True)
        file.close()
        assert out.read_text(encoding="utf-8") == saved + saved.split("\n")[1] + "\n"
    for content in (saved.encode("cp1252", "replace"), saved.replace(",", ";").encode()):
        out.write_bytes(content)
        with pytest.raises(WatchError, match="another program saved it with other columns"):
            TagFile(video, out)


def test_files_that_are_not_ours_are_not_touched(tmp_path: Path) -> None:
    video, out = tmp_path / "match.webm", tmp_path / "mine.csv"
    video.write_bytes(b"film")
    out.write_text("mine\n")
    for options, says in (
        (TagOptions(tag=video, out=out), "without its inputs"),
        (TagOptions(tag=tmp_path / "none.mp4", out=tmp_path / "new.csv"), "no such file"),
        (TagOptions(tag=video, out=tmp_path / "new.parquet"), "ends in .csv"),
        (TagOptions(tag=video), "belong together"),
    ):
        with pytest.raises(WatchError, match=says):
            options.open()
    assert out.read_text() == "mine\n"
    with pytest.raises(msgspec.ValidationError):  # no formula gets into the table
        requests([{**row, "player": "=HYPERLINK()"} for row in tagged(tmp_path, RALLY)["rows"]])


def test_the_video_alone_is_served_in_ranges(tmp_path: Path) -> None:
    video = tmp_path / "match.webm"
    video.write_bytes(bytes(range(256)))
    (tmp_path / "secret.webm").write_bytes(b"secret")
    with running(tmp_path, video=video) as address:
        status, content, headers = get(address[1], "/video", Range="bytes=10-19")
        assert (status, content) == (206, bytes(range(10, 20)))
        assert headers["content-type"] == "video/webm"
        assert "media-src 'self' blob:" in headers["content-security-policy"]
        assert [get(address[1], path)[0] for path in ("/video/../secret.webm", "/secret.webm", "/video/secret.webm")] == [404] * 3
        assert get(address[1], "/video", Host="evil.example")[0] == 403
    with running(tmp_path) as address:
        assert get(address[1], "/video")[0] == 404


@pytest.mark.slow
def test_a_rally_in_the_page(page_folder: Path, viewer: Viewer, tmp_path: Path) -> None:
    import av

    video, out = tmp_path / "match.webm", tmp_path / "match.csv"
    with av.open(str(video), "w") as container:
        stream: Any = container.add_stream("libvpx-vp9", rate=10)
        stream.width, stream.height, stream.pix_fmt = 160, 90, "yuv420p"
        for shade in range(40):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((90, 160, 3), 4 * shade, np.uint8), format="rgb24")))
        container.mux(stream.encode())
    flags, page = ("--tag", str(video), "--out", str(out)), viewer.page

    def saved() -> bool:
        return bool(viewer.state("unsaved") == 0)

    with serving(*flags) as server:
        viewer.open(server.address)
        page.fill("[name=near]", "Ada")
        page.fill("[name=far]", "Bea")
        page.click("text=Begin")
        assert page.locator("form :invalid").get_attribute("name") == "discipline", "it is asked"
        page.select_option("[name=discipline]", "WS")
        page.click("text=Begin")
        viewer.until(lambda: viewer.state("suggested") is not None)
        assert viewer.state("suggested")[0] == "short-serve"
        assert page.inner_text(".prompt") == "Click the corner of the court: near left (outer lines)"
        box = page.locator("video").bounding_box()

        def click(x: float, y: float) -> None:
            page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])

        for x, y in (CLICKS[0], CLICKS[3], CLICKS[2]):
            click(x, y)
        assert "This is not the far right corner" in page.inner_text(".refusal")
        viewer.press("Backspace")
        for x, y in CLICKS[1:]:
            click(x, y)
        assert page.inner_text(".prompt").startswith("Do the drawn lines lie on those of the court?")
        assert page.locator(".picture polyline").count() == 13
        viewer.press("Enter")
        assert page.inner_text(".prompt") == "Ada serves"

        def show(time: float) -> None:
            page.evaluate("(t) => { const film = document.querySelector('video'); film.pause(); film.currentTime = t; }", time)

        def film(what: str) -> Any:
            return page.evaluate(f"document.querySelector('video').{what}")

        # The stroke is struck when its place is entered; then the film shows its flight, and stops before the next one.
        for time, keys in ((1.0, "s"), (1.5, "7l"), (2.5, "1s")):
            show(time)
            for key in keys:
                viewer.press(key)
                if key.isdigit():
                    viewer.until(lambda: film("paused") and film("currentTime") > time + 0.5)  # noqa: B023
                    assert film("playbackRate") == 0.5
                    viewer.until(lambda: viewer.state("suggested") is not None)
        viewer.until(lambda: not film("paused"), 10)
        viewer.press("c")  # shot keys sleep while the place is asked for
        assert "Shot keys sleep" in page.inner_text(".refusal")
        viewer.press("6", "Backspace", "4", "i")
        assert viewer.state("phase", "rally") == ["shot", 2]
        assert "Ada 1 : 0 Bea" in page.inner_text(".score")
        viewer.until(saved)
        page.click("text=Bea: lift")
        assert film("currentTime") == 1.5
        assert page.inner_text(".spans") == "0 : 0"
        page.goto("about:blank")
        server.process.kill()
        server.process.wait()
    with serving(*flags) as server:
        viewer.open(server.address)
        assert viewer.state("phase", "rally", "inputs") == ["shot", 2, 13]
        viewer.press("Backspace", "Backspace")
        assert viewer.state("phase", "rally", "inputs") == ["place", 1, 11]
        box = page.locator("video").bounding_box()
        page.keyboard.down("Shift")
        click(0.5, 0.25)
        page.keyboard.up("Shift")
        assert viewer.state("phase", "rally") == ["shot", 2]
        viewer.until(saved)
        page.set_viewport_size({"width": 390, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        page.goto("about:blank")
    strokes = read_matches(out)
    assert [SHOTS[code] for code in strokes["shot"].to_pylist()] == ["short-serve", "lift", "smash"]
    assert [AREAS[code] for code in strokes["area"].to_pylist()] == ["back-right", "back-left", "middle-centre"]
    assert strokes["frame"].to_pylist() == [30, 45, 75]
