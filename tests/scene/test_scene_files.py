"""Scene files, read by the official reader and held against log and motions: sizes of the court, and layouts."""

import dataclasses
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from shuttle_marl.court.recorded import LogRallies
from shuttle_marl.court.scene import write as topics
from shuttle_marl.court.scene.shapes import WORLD, bone_frame
from shuttle_marl.court.scene.write import CUT, EPOCH, LAYOUTS, write_scene
from shuttle_marl.court.staging import BONES, stage
from shuttle_marl.court.staging.skeleton import SWEET_SPOT, load_skeleton
from shuttle_marl.exact import evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREA_WORDS
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.tables import ROOT
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog
from tests import golden
from tests.scene.conftest import Reel

MOST_A_SECOND = 60


def test_topics_have_the_schemas_of_the_viewers(reel: Any) -> None:
    summary = make_reader(io.BytesIO(reel.content)).get_summary()
    schema = {c.topic: (summary.schemas[c.schema_id].name, c.message_encoding) for c in summary.channels.values()}
    for topic in topics.SCENES:
        assert schema[topic] == ("foxglove.SceneUpdate", "protobuf")
    assert schema[topics.TF] == ("foxglove.FrameTransforms", "protobuf")
    assert {topic for topic, (_, encoding) in schema.items() if encoding == "json"} == set(topics.SCHEMAS)


def test_messages_are_ordered_and_their_rate_is_limited(reel: Any) -> None:
    times = [time for time, _, _ in reel.messages]
    assert times == sorted(times)
    assert times[0] == EPOCH
    for topic in {name for _, name, _ in reel.messages}:
        own = np.array([time for time, _ in reel.of(topic)])
        in_a_second = np.searchsorted(own, own + 10**9) - np.arange(len(own))
        assert in_a_second.max() <= MOST_A_SECOND, topic


def test_every_instant_has_every_frame_of_reference(reel: Any) -> None:
    used = {entity.frame_id for topic in topics.SCENES for _, message in reel.of(topic) for entity in message.entities}
    moving = used - {WORLD}
    assert {"0/Racket", "1/Head", "player_0", "player_1", "shuttle", "shuttle_floor"} < moving
    times = np.array([time for time, _ in reel.of(topics.TF)])
    for time, message in reel.of(topics.TF):
        assert {transform.child_frame_id for transform in message.transforms} == moving
        assert {transform.timestamp.ToNanoseconds() for transform in message.transforms} == {time}
    steps = np.diff(times)
    assert set(steps.tolist()) == {10**9 // 50, CUT}, "rallies are a millisecond apart"
    assert (steps == CUT).sum() == len(reel.numbers) - 1


def test_transforms_follow_the_motion(reel: Any, log_path: Path) -> None:
    start, off, tip_off, shuttle_off = EPOCH, [], [], []
    with RallyLog(log_path) as log:
        rallies = LogRallies(log, default_game())
        for number in reel.numbers:
            rally = dataclasses.replace(rallies.rally(number), hands=("right", "left"))
            motion = stage(rally, seed=rally.key, athletes=("male", "female"))
            for frame in range(0, len(motion.time), 13):
                at = reel.placed(start + round(float(motion.time[frame]) * 10**9))
                shuttle_off.append(np.linalg.norm(at["shuttle"][1] - motion.shuttle[frame]))
                for seat in (0, 1):
                    for i, bone in enumerate(BONES):
                        if bone_frame(seat, bone) in at:
                            off.append(np.linalg.norm(at[bone_frame(seat, bone)][1] - motion.position[frame, seat, i]))
                    turn, place = at[bone_frame(seat, "Racket")]
                    strings = place + SWEET_SPOT * turn @ motion.racket(seat)[0]
                    tip_off.append(np.linalg.norm(strings - motion.sweet_spot[frame, seat]))
            start += round(float(motion.time[-1]) * 10**9) + CUT
    assert max(*off, *shuttle_off) < 2e-4
    assert max(tip_off) < 1e-3


def test_players_stand_on_the_floor_with_their_shapes_together(reel: Any) -> None:
    """Soles on the floor, heads as high as people, every limb as long as the way to the next bone, and both kits apart."""
    ((_, shown),) = reel.of(topics.PLAYERS)
    shapes = {entity.frame_id: entity for entity in shown.entities}
    at = reel.placed(EPOCH + 10**8)

    def ends(bone: str) -> list[Any]:
        """Both ends of a limb's cylinder on the court."""
        turn, place = at[bone]
        (rod, *_) = shapes[bone].cylinders
        q, centre = rod.pose.orientation, rod.pose.position
        along = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([0, 0, rod.size.z / 2])
        return [place + turn @ (np.array([centre.x, centre.y, centre.z]) + sign * along) for sign in (-1, 1)]

    for seat, height in enumerate((1.787, 1.701)):
        for side in ("Left", "Right"):
            for bone, following in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot")):
                near, far = ends(f"{seat}/{side}{bone}")
                assert near == pytest.approx(at[f"{seat}/{side}{bone}"][1], abs=1e-6)
                assert far == pytest.approx(at[f"{seat}/{side}{following}"][1], abs=0.005)
            shoe = shapes[f"{seat}/{side}Foot"].spheres[0]
            turn, place = at[f"{seat}/{side}Foot"]
            sole = place + turn @ [shoe.pose.position.x, shoe.pose.position.y, shoe.pose.position.z - shoe.size.z / 2]
            assert sole[2] == pytest.approx(0, abs=0.03)
        turn, place = at[f"{seat}/Head"]
        top = max(
            (place + turn @ [ball.pose.position.x, ball.pose.position.y, ball.pose.position.z + ball.size.z / 2])[2]
            for ball in shapes[f"{seat}/Head"].spheres
        )
        assert height - 0.25 < top < height + 0.03
    shirts = [next(ball.color for ball in shapes[f"{seat}/Spine2"].spheres) for seat in (0, 1)]
    assert shirts[0].b > 2 * shirts[1].b
    assert shirts[1].r > 2 * shirts[0].r


def test_rackets_meet_the_shuttle_in_the_file(reel: Any) -> None:
    hand = {0: True, 1: False}
    athlete = {0: "male", 1: "female"}
    strokes = reel.of(topics.STROKE)
    assert len(strokes) > 5
    for time, stroke in strokes:
        at, seat = reel.placed(time), stroke["seat"]
        shaft, _ = load_skeleton(athlete[seat]).racket(right_handed=hand[seat])
        turn, place = at[bone_frame(seat, "Racket")]
        assert np.linalg.norm(place + SWEET_SPOT * turn @ shaft - at["shuttle"][1]) < 0.012


def test_players_change_ends(reel: Any, second_game: Any) -> None:
    for shot, near in ((reel, 0), (second_game, 1)):
        for time, _ in shot.of(topics.STROKE):
            at = shot.placed(time)
            for seat in (0, 1):
                assert (at[bone_frame(seat, "Hips")][1][1] < 0) == (seat == near)
    (mark,) = (e for _, message in second_game.of(topics.STROKE_MARKS) for e in message.entities if e.id == "landing")
    last = second_game.placed(second_game.messages[-1][0])
    turn, _ = last[mark.frame_id]
    down = turn @ [mark.cylinders[0].pose.position.x, mark.cylinders[0].pose.position.y, 0.0]
    assert np.linalg.norm(down[:2] - last["shuttle"][1][:2]) < 1.5, "the shuttle rolls no farther"


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
                if i:  # the score mirrors serves
                    assert message["area"] == AREA_WORDS[log.catalogue.area[stroke]], "to the forehand of a left-hander, too"
                assert message["player"] == log.policies[int(rally.policy[0, message["seat"]])].name
            assert rally.outcome(log.catalogue)[-1] == (message["end"] == "winner")
            before, after = [m for _, m in reel.of(topics.SCORE) if m["rally"] == number]
            points = [int(p) for p in rally.score[0, :2]]
            assert [before["points_0"], before["points_1"]] == points
            points[int(rally.winner[0])] += 1
            assert [after["points_0"], after["points_1"]] == points
            assert after["winner"] == int(rally.winner[0])
    assert next(told, None) is None


def test_the_scoreboard_shows_names_and_points(reel: Any) -> None:
    states = {(m["rally"], m["points_0"], m["points_1"]): m for _, m in reel.of(topics.SCORE)}
    seen = set()
    for _, update in reel.of(topics.BOARD):
        rows = update.entities[0].texts[0].text.splitlines()[:2]
        seen.add(tuple(tuple(row.strip("> ").split()) for row in rows))
    assert {tuple((m[f"name_{k}"], str(m[f"points_{k}"])) for k in (0, 1)) for m in states.values()} == {
        tuple((row[0], row[-1]) for row in rows) for rows in seen
    }


def test_probabilities_are_those_of_the_game_and_values_exact(reel: Any, log_path: Path) -> None:
    game = default_game()
    tables = {name: tabulate(resolve(name, game), game) for name in ("bc", "random")}
    score, (_, first) = reel.of(topics.SCORE)[0][1], reel.of(topics.STROKE)[0]
    odds = evaluate(tables[score["name_0"]], tables[score["name_1"]]).odds(0)
    assert first["rally_win_0"] == pytest.approx(odds.serving if score["server"] == 0 else odds.receiving, abs=1e-9)
    assert first["match_win_0"] == pytest.approx(odds.match(first_server=score["server"]), abs=1e-9)
    for _, stroke in reel.of(topics.STROKE):
        assert 0 <= stroke["p_succ"] <= 1
        assert 0 < stroke["probability"] <= 1
        likeliest = [option["probability"] for option in stroke["top"]]
        assert likeliest == sorted(likeliest, reverse=True)
        for option in stroke["top"]:
            if option["stroke"] == stroke["stroke"]:
                assert (option["probability"], option["win_probability"]) == (stroke["probability"], stroke["win_probability"])
    strokes = [game.catalogue.names[s] for s in game.legal_strokes(ROOT)]
    p_succ, _, _ = game.stroke_probabilities()
    assert first["p_succ"] == p_succ[game.pair_start[ROOT] + strokes.index(first["stroke"])]


def test_files_are_reproducible(reel: Any, log_path: Path) -> None:
    with RallyLog(log_path) as log:
        again, _ = write_scene(log, reel.numbers[:1], default_game())
        once_more, _ = write_scene(log, reel.numbers[:1], default_game())
    assert again == once_more


DOCUMENTS = {path.name: json.loads(path.read_bytes()) for path in LAYOUTS}


def texts(thing: Any) -> list[str]:
    if isinstance(thing, dict):
        return [text for key, value in thing.items() for text in [key, *texts(value)]]
    if isinstance(thing, list):
        return [text for value in thing for text in texts(value)]
    return [thing] if isinstance(thing, str) else []


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_path_is_a_field_of_a_topic(name: str) -> None:
    paths = [text for text in texts(DOCUMENTS[name]) if re.match(r"/(rally|scene|log|tf)", text)]
    assert set(topics.SCENES) <= set(paths)
    plotted = [path for path in paths if "." in path]
    assert len(plotted) >= 8
    for path in plotted:
        topic, *fields = path.replace("[:]", "").split(".")
        if topic == topics.TF:
            continue
        schema = topics.SCHEMAS[topic]
        for field in fields:
            schema = schema["properties"][field]


def test_a_scene_is_what_somebody_looked_at(reel: Reel) -> None:
    """Sums of all numbers of a topic, with weights: what changes anywhere changes them."""
    found: dict[str, Any] = {}
    for topic in sorted({topic for _, topic, _ in reel.messages}):
        said = re.sub(r"timestamp {[^}]*}|n?sec: \d+", "", "\n".join(str(message) for _, message in reel.of(topic)))
        numbers = np.array([float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", said)])
        found[topic] = [len(reel.of(topic)), golden.weighted_sum(numbers)]
    golden.check("scene", found, 1e-3)
