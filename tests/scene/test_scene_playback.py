"""Play, pause, seek and speed: the state of a playback."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.scene import SceneError
from shuttle_marl.scene.playback import FASTEST, SLOWEST, Playback, Status


@pytest.fixture
def playback(reel: Any) -> Playback:
    return Playback(reel.content)


def test_a_new_playback_waits_at_the_start(playback: Playback, reel: Any) -> None:
    assert (playback.status, playback.position) == (Status.PAUSED, reel.messages[0][0])
    assert playback.advance(10) == []
    assert {m.topic for m in playback.latest()} >= {"/scene/court", "/scene/players", "/tf", "/rally/score"}


def test_playing_sends_every_message_once_and_in_order(playback: Playback, reel: Any) -> None:
    first = len([time for time, _, _ in reel.messages if time == playback.start])
    playback.play()
    sent = []
    while playback.status is Status.PLAYING:
        sent += playback.advance(0.37)
    assert playback.status is Status.ENDED
    assert playback.position == playback.end
    assert [(m.time, m.topic) for m in sent] == [(time, topic) for time, topic, _ in reel.messages[first:]]


def test_speed_is_times_real_time(playback: Playback) -> None:
    playback.play()
    playback.set_speed(2.5)
    playback.advance(0.8)
    assert playback.position - playback.start == 2_000_000_000
    for asked, got in ((0.0, SLOWEST), (1e9, FASTEST), (float("nan"), FASTEST)):
        playback.set_speed(asked)
        assert playback.speed == got


def test_a_pause_holds_and_a_play_from_the_end_begins_again(playback: Playback) -> None:
    playback.play()
    playback.advance(0.5)
    playback.pause()
    assert playback.advance(5) == []
    playback.play()
    playback.advance(1e6)
    assert playback.status is Status.ENDED
    playback.pause()
    assert playback.status is Status.ENDED
    playback.play()
    assert (playback.status, playback.position) == (Status.PLAYING, playback.start)


@settings(max_examples=25, deadline=None)
@given(share=st.floats(-0.5, 1.5), seconds=st.floats(0, 3))
def test_after_a_seek_the_latest_of_every_topic_is_shown(reel: Any, share: float, seconds: float) -> None:
    playback = _cached(reel)
    playback.pause()
    playback.seek(round(playback.start + share * (playback.end - playback.start)))
    assert playback.start <= playback.position <= playback.end
    expected = {topic: (time, topic) for time, topic, _ in reel.messages if time <= playback.position}
    assert {m.topic: (m.time, m.topic) for m in playback.latest()} == expected
    playback.play()
    before = playback.position
    due = playback.advance(seconds)
    assert all(before < m.time <= playback.position for m in due)


_KEPT: dict[int, Playback] = {}


def _cached(reel: Any) -> Playback:
    return _KEPT.setdefault(id(reel), Playback(reel.content))


def test_what_is_no_scene_cannot_be_played() -> None:
    with pytest.raises(SceneError, match="no scene"):
        Playback(b"nothing")
