"""Rallies as text and as pictures."""

import dataclasses
import itertools
import os
import subprocess
import sys

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.render import CourtRenderer, in_words, plan_of, px
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, area_of, mirrored
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.rules import OUTCOMES
from tests import golden
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


os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

pygame = pytest.importorskip("pygame")


@pytest.fixture
def fast(monkeypatch):
    for module in (rally_v0, match_v0):
        monkeypatch.setitem(module.raw_env.metadata, "render_fps", 0)


def test_the_picture_changes_with_every_stroke(play):
    env = rally_v0.env(render_mode="rgb_array")
    frames = [env.render() for *_, terminated, _, _, _ in play(env, 11) if not terminated]
    frames.append(env.render())
    assert len(frames) > 3
    assert all((before != after).any() for before, after in itertools.pairwise(frames))


@pytest.mark.parametrize("game", ["default", "default:recovery"])
def test_pictures_are_those_that_somebody_looked_at(play, game):
    env = match_v0.env(render_mode="rgb_array", game=game)
    found = {}
    for number, _ in enumerate(itertools.islice(play(env, 11), 12)):
        plan, picture = plan_of(env.unwrapped.snapshot()), env.render().astype(float)
        found[f"{game} {number}"] = [plan.shuttle, plan.bodies]
        found[f"{game} {number}, picture"] = picture.reshape(8, 70, 12, 75, 3).mean(axis=(1, 3, 4))
    golden.check("drawn_rallies", found, 0.01)


def test_lines_of_the_court_are_those_of_the_laws():
    """Law 1: lines are brighter than the floor 20 cm beside them."""
    env = rally_v0.env(render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render().astype(int).sum(axis=2)
    for side in (-1, 1):
        along = [((side * x, y), (0.2, 0.0)) for x in (6.7, 5.94, 1.98) for y in (-2.8, 1.3)]
        along += [((x, side * y), (0.0, 0.2)) for x in (-6.3, -4.1, 4.1, 6.3) for y in (2.59, 3.05)]
        along += [((side * 3.2, 0.0), (0.0, 0.2))]
        for at, beside in along:
            (x, y), *floor = (np.rint(px(np.array(at) + k * np.array(beside)) / 2).astype(int) for k in (0, -1, 1))
            assert frame[y, x] > 100 + max(frame[other[1], other[0]] for other in floor), at


def test_a_window_follows_the_rally_and_can_be_closed(fast, play):
    env = match_v0.env(render_mode="human", max_strokes=30)
    rows = play(env, 0)
    next(rows)
    window = pygame.display.get_surface()
    before = pygame.surfarray.array3d(window)
    assert (before.swapaxes(0, 1) == CourtRenderer("", fps=0).frame(env.unwrapped.snapshot())).all()
    next(rows)
    assert (pygame.surfarray.array3d(window) != before).any()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    next(rows)
    assert pygame.display.get_surface() is None
    assert len(list(rows)) > 20, "the match continues without the window"
    env.close()


def test_a_missing_pygame_is_named_with_the_cure():
    code = """
import sys
sys.modules["pygame"] = None
from shuttle_marl import rally_v0
from shuttle_marl.base.errors import ShuttleError
env = rally_v0.env(render_mode="rgb_array")
env.reset(seed=0)
try:
    env.render()
except ShuttleError as error:
    print(error)
text = rally_v0.env(render_mode="ansi")
text.reset(seed=0)
print(text.render())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "need pygame, which is not installed ('ansi' works without); `make install`" in done.stdout
    assert "is to serve" in done.stdout
