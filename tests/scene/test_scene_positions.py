"""Positions of receivers in scenes: in the stroke message, as a disc where they wait, and absent without them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.court.match import Match, MatchLog, PolicyTables
from shuttle_marl.court.plan import Plan, Side
from shuttle_marl.court.scene import write as topics
from shuttle_marl.court.scene.write import write_scene
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.shipped import load_game, waiting_places
from shuttle_marl.game.tables import Game
from shuttle_marl.recording import RallyLog, RallyRecorder
from tests.reduced import reduced_model
from tests.scene.conftest import read


@pytest.fixture(scope="module")
def game() -> Game:
    return load_game(f"{reduced_model()}:recovery")


@pytest.fixture(scope="module")
def recovery_log(game: Game, tmp_path_factory: pytest.TempPathFactory) -> Path:
    policies = PolicyTables(game)
    plan, folder = Plan(seed=6, sides=(Side(policy="bc"), Side(policy="safe"))), tmp_path_factory.mktemp("log")
    log, match = MatchLog(folder, policies), Match(plan, policies)
    for number in range(3):
        log.add(plan, match.rally(number))
    log.close()
    return next(folder.glob("*.mcap"))


def test_a_scene_tells_and_shows_where_receivers_wait(recovery_log: Path, game: Game) -> None:
    with RallyLog(recovery_log) as log:
        number = int(np.argmax(log.rally_table()["length"]))
        row = log.rally(number)
        content, unknown = write_scene(log, [number], game)
    assert unknown == {}
    messages = read(content)
    strokes = [message for _, topic, message in messages if topic == topics.STROKE]
    marks = [message for _, topic, message in messages if topic == topics.STROKE_MARKS][1:]
    assert len(strokes) == len(row.waited) > 3
    assert "waited" not in strokes[0], "the receiver of a serve has no choice"
    told = 0
    for stroke, position, mark in zip(strokes, row.waited.tolist(), marks, strict=False):
        discs = [entity.cylinders[0].pose.position for entity in mark.entities if entity.id == "waited"]
        assert ("waited" in stroke) == (len(discs) == 1)
        if discs:
            assert stroke["waited"] == POSITIONS[position]
            across, away = waiting_places()[position]
            facing = -1 if stroke["seat"] == 0 else 1
            assert (discs[0].x, discs[0].y) == pytest.approx((facing * across, -facing * away))
            told += 1
    assert told > 1
    summary = next(message for _, topic, message in messages if topic == topics.SUMMARY)
    assert [stroke.get("waited") for stroke in summary["strokes"]] == [stroke.get("waited") for stroke in strokes]


def test_a_log_without_positions_is_written_as_before(recovery_log: Path, game: Game, tmp_path: Path) -> None:
    with RallyLog(recovery_log) as log:
        header = dataclasses.replace(log.files[0].header, columns=())
        rows = dataclasses.replace(log.rally(0), waited=None)
    recorder = RallyRecorder.create(tmp_path / "old.mcap", header)
    recorder.add(rows)
    recorder.close()
    with RallyLog(tmp_path / "old.mcap") as log:
        messages = read(write_scene(log, [0], game)[0])
    assert all("waited" not in message for _, topic, message in messages if topic == topics.STROKE)
    marks = [message for _, topic, message in messages if topic == topics.STROKE_MARKS]
    assert {entity.id for mark in marks for entity in mark.entities} == {"path", "target", "landing"}
