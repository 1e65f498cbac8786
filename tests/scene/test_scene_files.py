"""Scene files: their content, read by the official reader, and held against the log and the motions."""

import io
import itertools
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from mcap.reader import make_reader

from shuttle_marl.exact import evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.rally import ROOT
from shuttle_marl.game.table import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.tables import outcomes
from shuttle_marl.scene import topics
from shuttle_marl.scene.layouts import LAYOUTS
from shuttle_marl.scene.moving import PLAY, SHADOWS, WORLD
from shuttle_marl.scene.write import EPOCH, write_scene
from shuttle_marl.staging import BONES, SWEET_SPOT, load_skeleton
from shuttle_marl.staging.rotation import matrix

RERUN = shutil.which("rerun", path=sysconfig.get_path("scripts"))
MOST_A_SECOND = 60


def placed(transforms: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rotation and place of every frame of reference against the court, from one message."""
    own = {t.child_frame_id: t for t in transforms.transforms}
    out: dict[str, tuple[np.ndarray, np.ndarray]] = {WORLD: (np.eye(3), np.zeros(3))}

    def of(name: str) -> tuple[np.ndarray, np.ndarray]:
        if name not in out:
            t, (turn, place) = own[name], of(own[name].parent_frame_id)
            r, p = t.rotation, t.translation
            q = np.array([r.x, r.y, r.z, r.w])
            out[name] = (turn @ matrix(q / np.linalg.norm(q)), place + turn @ np.array([p.x, p.y, p.z]))
        return out[name]

    for name in own:
        of(name)
    return out


def test_topics_have_the_schemas_that_viewers_know(reel: Any) -> None:
    summary = make_reader(io.BytesIO(reel.content)).get_summary()
    schema = {c.topic: (summary.schemas[c.schema_id].name, c.message_encoding) for c in summary.channels.values()}
    for topic in topics.SCENES:
        assert schema[topic] == ("foxglove.SceneUpdate", "protobuf")
    assert schema[topics.TF] == ("foxglove.FrameTransforms", "protobuf")
    assert schema[topics.LOG] == ("foxglove.Log", "protobuf")
    assert {topic for topic, (_, encoding) in schema.items() if encoding == "json"} == set(topics.SCHEMAS)


def test_messages_come_in_order_and_not_too_many_a_second(reel: Any) -> None:
    times = [time for time, _, _ in reel.messages]
    assert times == sorted(times)
    assert times[0] == EPOCH
    for topic in {name for _, name, _ in reel.messages}:
        own = np.array([time for time, _ in reel.of(topic)])
        in_a_second = np.searchsorted(own, own + 10**9) - np.arange(len(own))
        assert in_a_second.max() <= MOST_A_SECOND, topic


@pytest.mark.skipif(RERUN is None, reason="rerun-sdk is not installed")
def test_another_program_finds_nothing_wrong(scene_file: Path) -> None:
    done = subprocess.run([str(RERUN), "mcap", "check", "--full", str(scene_file)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert topics.TF in done.stdout


def test_static_things_come_once_and_first(reel: Any) -> None:
    for topic in (topics.COURT, topics.PLAYERS):
        ((time, message),) = reel.of(topic)
        assert time == EPOCH
        assert all(entity.frame_locked and entity.lifetime.ToNanoseconds() == 0 for entity in message.entities)


def test_every_scene_message_stands_for_itself(reel: Any) -> None:
    for topic in topics.SCENES:
        for _, message in reel.of(topic):
            assert [deletion.type for deletion in message.deletions] == [1], "deletes all that was there"


def test_every_frame_of_reference_is_told_in_every_frame(reel: Any) -> None:
    named = {f"player_{seat}/{bone}" for seat in (0, 1) for bone in (*BONES, "name")} | {"shuttle", PLAY, *SHADOWS}
    used = {entity.frame_id for topic in topics.SCENES for _, message in reel.of(topic) for entity in message.entities}
    assert used <= named | {WORLD}
    assert {"player_0/Racket", "player_1/Head", "player_1/name", "shuttle", PLAY} <= used
    for _, message in reel.of(topics.TF):
        assert {t.child_frame_id for t in message.transforms} == named


def test_rackets_meet_the_shuttle_in_the_file(reel: Any) -> None:
    """There is a frame at the very time of every stroke, and in it the strings are where the shuttle is."""
    frames = dict(reel.of(topics.TF))
    hand = {0: True, 1: False}
    athlete = {0: "male", 1: "female"}
    strokes = reel.of(topics.STROKE)
    assert len(strokes) > 5
    for time, stroke in strokes:
        at, seat = placed(frames[time]), stroke["seat"]
        shaft, _ = load_skeleton(athlete[seat]).racket(right_handed=hand[seat])
        turn, place = at[f"player_{seat}/Racket"]
        assert np.linalg.norm(place + SWEET_SPOT * turn @ shaft - at["shuttle"][1]) < 0.012


def test_names_hang_over_the_heads(reel: Any) -> None:
    for _, message in reel.of(topics.TF)[::50]:
        at = placed(message)
        for seat in (0, 1):
            name, head = at[f"player_{seat}/name"], at[f"player_{seat}/Head"]
            assert name[1] - head[1] == pytest.approx([0, 0, 0.42], abs=1e-3)


def test_players_change_ends(reel: Any, second_game: Any) -> None:
    """In the second game all is turned round: players, states, and where the shuttle comes down."""
    for shot, near in ((reel, 0), (second_game, 1)):
        frames = dict(shot.of(topics.TF))
        assert shot.of(topics.STATE)
        for time, state in shot.of(topics.STATE):
            at = placed(frames[time])
            for seat in (0, 1):
                x, y, _ = at[f"player_{seat}/Hips"][1]
                assert (y < 0) == (seat == near)
                assert (state[f"player_{seat}"]["x"], state[f"player_{seat}"]["y"]) == pytest.approx((x, y), abs=2e-3)
            shuttle = state["shuttle"]
            assert at["shuttle"][1] == pytest.approx([shuttle["x"], shuttle["y"], shuttle["z"]], abs=2e-3)
    (mark,) = (e for _, message in second_game.of(topics.STROKE_MARKS) for e in message.entities if e.id == "landing")
    last = placed(second_game.of(topics.TF)[-1][1])
    turn, _ = last[mark.frame_id]
    down = turn @ [mark.cylinders[0].pose.position.x, mark.cylinders[0].pose.position.y, 0.0]
    assert np.linalg.norm(down[:2] - last["shuttle"][1][:2]) < 1.5, "the shuttle rolls no farther"


def test_shuttles_fly_cork_first(reel: Any) -> None:
    frames = reel.of(topics.TF)
    strokes = [time for time, _ in reel.of(topics.STROKE)]
    for (time, first), (_, second) in itertools.islice(itertools.pairwise(frames), 0, None, 7):
        since = min((time - stroke for stroke in strokes if stroke <= time), default=None)
        if since is None or not 0.1e9 < since < 0.3e9:
            continue
        (turn, before), (_, after) = placed(first)["shuttle"], placed(second)["shuttle"]
        if np.linalg.norm(after - before) > 0.1:
            assert turn[:, 2] @ (after - before) / np.linalg.norm(after - before) > 0.95


def test_strokes_and_scores_are_those_of_the_log(reel: Any, log_path: Path) -> None:
    told = iter(reel.of(topics.STROKE))
    with RallyLog(log_path) as log:
        for number in reel.numbers:
            rally = log.rally(number)
            for i, stroke in enumerate(rally.stroke):
                _, message = next(told)
                assert message["number"] == i + 1
                assert message["stroke"] == log.catalogue.names[stroke]
                assert message["seat"] == (int(rally.server[0]) + i) % 2
                assert message["player"] == log.policies[int(rally.policy[0, message["seat"]])].name
            assert outcomes(rally, log.catalogue)[-1] == (message["end"] == "winner")
            before, after = [m for _, m in reel.of(topics.SCORE) if m["rally"] == number]
            points = [int(p) for p in rally.score[0, :2]]
            assert [before["points_0"], before["points_1"]] == points
            points[int(rally.winner[0])] += 1
            assert [after["points_0"], after["points_1"]] == points
            assert after["winner"] == int(rally.winner[0])
    assert next(told, None) is None


def test_probabilities_are_those_of_the_game_and_values_exact(reel: Any, log_path: Path) -> None:
    game = default_game()
    tables = {name: tabulate(resolve(name, game), game) for name in ("bc", "random")}
    first = reel.of(topics.SCORE)[0][1]
    names = (first["name_0"], first["name_1"])
    value = evaluate(tables[names[0]], tables[names[1]])
    odds = value.odds(0)
    serving = first["server"] == 0
    values = [message for _, message in reel.of(topics.VALUE)]
    assert values[0]["rally_win_0"] == pytest.approx(odds.serving if serving else odds.receiving, abs=1e-9)
    assert values[0]["match_win_0"] == pytest.approx(odds.match(first_server=first["server"]), abs=1e-9)
    for _, policy in reel.of(topics.POLICY):
        assert sum(policy["shots"].values()) == pytest.approx(1, abs=1e-6)
        probabilities = [option["probability"] for option in policy["top"]]
        assert probabilities == sorted(probabilities, reverse=True)
    by_time = dict(reel.of(topics.VALUE))
    for time, stroke in reel.of(topics.STROKE):
        assert 0 <= stroke["p_succ"] <= 1
        assert 0 < stroke["probability"] <= 1
        told = by_time[time]
        assert told["chosen"] == stroke["win_probability"]
        best = max(option["win_probability"] for option in dict(reel.of(topics.POLICY))[time]["top"])
        assert told["striker"] <= best + 1e-6 or told["striker"] < 1
    serve = game.pair_start[ROOT]
    p_succ, _, _ = game.stroke_probabilities()
    strokes = game.legal_strokes(ROOT)
    name = reel.of(topics.STROKE)[0][1]["stroke"]
    assert reel.of(topics.STROKE)[0][1]["p_succ"] == p_succ[serve + [game.catalogue.names[s] for s in strokes].index(name)]


def test_a_mean_over_the_policy_is_the_value(reel: Any) -> None:
    """The value of a state is the mean of the values of its strokes, as the policy chooses them."""
    for time, policy in reel.of(topics.POLICY):
        covered = sum(option["probability"] for option in policy["top"])
        if covered < 0.999:
            continue
        mean = sum(option["probability"] * option["win_probability"] for option in policy["top"]) / covered
        assert mean == pytest.approx(dict(reel.of(topics.VALUE))[time]["striker"], abs=2e-3)


def test_messages_hold_what_their_schema_says(reel: Any) -> None:
    kinds = {"number": (int, float), "integer": int, "string": str, "object": dict, "array": list}

    def check(content: Any, schema: dict[str, Any], where: str) -> None:
        assert isinstance(content, kinds[schema["type"]]), where
        if schema["type"] == "object":
            assert set(content) <= set(schema["properties"]), where
            for name, value in content.items():
                check(value, schema["properties"][name], f"{where}.{name}")
        elif schema["type"] == "array":
            for value in content:
                check(value, schema["items"], f"{where}[]")
        elif schema["type"] == "number":
            assert np.isfinite(content), where

    for topic, schema in topics.SCHEMAS.items():
        assert reel.of(topic), topic
        for _, message in reel.of(topic):
            check(message, schema, topic)


def test_attachments_and_origin(reel: Any, log_path: Path) -> None:
    reader = make_reader(io.BytesIO(reel.content))
    files = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
    assert set(files) == {*LAYOUTS, "rallies.arrow"}
    rows = pa.ipc.open_file(files["rallies.arrow"]).read_all()
    assert rows["number"].to_pylist() == reel.numbers
    (facts,) = (found.metadata for found in reader.iter_metadata())
    assert facts["game"] == default_game().hash
    assert facts["log"] == log_path.name
    assert facts["rallies"].split() == [str(number) for number in reel.numbers]


def test_the_same_rallies_give_the_same_file(reel: Any, log_path: Path) -> None:
    with RallyLog(log_path) as log:
        again, _ = write_scene(log, reel.numbers[:1], default_game(), fps=25)
        once_more, _ = write_scene(log, reel.numbers[:1], default_game(), fps=25)
    assert again == once_more
