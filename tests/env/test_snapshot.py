"""``match_v0``, and the positions and the text of its snapshots."""

import dataclasses

import numpy as np

from shuttle_marl import rally_v0
from shuttle_marl.env.snapshot import in_words, plan_of
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, area_of, mirrored
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.rules import OUTCOMES
from tests.reduced import reduced_model


def moments(play, env, seed):
    """Snapshots after every stroke of an episode."""
    for *_, action in play(env, seed, policy_seed=seed):
        if action is not None:
            yield env.unwrapped.snapshot()
    yield env.unwrapped.snapshot()


def test_strokes_land_where_they_are_aimed_and_the_next_contact_is_there(play):
    areas = set()
    for seed in range(30):
        for snapshot in moments(play, rally_v0.env(), seed):
            scene = plan_of(snapshot)
            assert len(scene.flights) == len(snapshot.strokes)
            assert all(abs(x) <= HALF_LENGTH + 1 and abs(y) <= HALF_WIDTH + 1 for x, y in scene.bodies)
            assert scene.bodies[0][0] < 0 < scene.bodies[1][0]
            contacts = [*(flight.start for flight in scene.flights), scene.shuttle]
            for flight, following in zip(scene.flights, contacts[1:], strict=True):
                assert flight.end == following
                stroke = flight.stroke
                if OUTCOMES[stroke.outcome] != "fault":
                    sign = 1 if stroke.player == 0 else -1
                    area = snapshot.game.catalogue.area[stroke.stroke]
                    assert area_of(np.array(flight.end[1] * sign), np.array(flight.end[0] * sign)) == area
                    areas.add(int(area))
    assert len(areas) == 9


def test_a_left_hander_is_drawn_in_the_mirror(play):
    game = pair_game("viktor-axelsen", "kento-momota", game=reduced_model())
    areas = set()
    for seed in range(10):
        for snapshot in moments(play, rally_v0.env(game=game), seed):
            assert snapshot.hands == ("right", "left")
            turned = plan_of(dataclasses.replace(snapshot, hands=("right", "right")))
            for flight, right in zip(plan_of(snapshot).flights, turned.flights, strict=True):
                stroke = flight.stroke
                if stroke.outcome != OUTCOMES.index("fault"):
                    sign = 1 if stroke.player == 0 else -1
                    area = int(game.catalogue.area[stroke.stroke])
                    where = area_of(np.array(flight.end[1] * sign), np.array(flight.end[0] * sign))
                    assert where == (mirrored(area) if stroke.player == 0 else area)
                    assert (flight.end == right.end) == (stroke.player == 1 or area % 3 == 1)
                    areas.add(area)
    assert len(areas) > 4


def test_text_tells_the_whole_rally(play):
    for seed in range(20):
        env = rally_v0.env(render_mode="ansi")
        rows = list(play(env, seed))
        text = env.render()
        lines = text.splitlines()
        strokes = [(agent, action) for agent, *_, action in rows if action is not None]
        assert len(lines) == len(strokes) + 3
        assert lines[1].startswith("effort: ")
        assert f"seed {seed}, {strokes[0][0]} serves" in lines[0]
        catalogue = env.unwrapped.game.catalogue
        for number, (line, (agent, action)) in enumerate(zip(lines[2:-1], strokes, strict=True), start=1):
            assert line.split()[:2] == [str(number), agent]
            assert in_words(catalogue, action) in line
        info = rows[-1][5]
        assert lines[-2].endswith(info["reason"])
        winner = next(agent for agent, _, reward, *_ in rows[-2:] if reward == 1)
        assert lines[-1] == f"{winner} wins the rally ({info['reason']})"


AGENTS = ("player_0", "player_1")
