"""Games of two persons by a link: what is hidden, who has a seat, and what a server allows."""

import time
from typing import Any

import msgspec
import numpy as np
import pytest

from shuttle_marl.game.scoring import Score
from shuttle_marl.watch import WatchError, friends, messages
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.friends import Friends
from shuttle_marl.watch.match import CourtRally
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.stager import Stager
from tests.watch.test_positions import plan_of

STAGER = Stager()


def asked(answers: Answers, **fields: Any) -> messages.FriendReply:
    reply: messages.FriendReply = answers._friends.answer(messages.FriendRequest(id=1, **fields))
    return reply


def begun(answers: Answers) -> tuple[messages.FriendReply, messages.FriendReply]:
    """Both seats of a new game."""
    host = asked(answers)
    guest = asked(answers, token=host.token)
    assert (host.refused, host.seat, host.friend) == (None, 0, "absent")
    assert (guest.refused, guest.seat, guest.friend) == (None, 1, "here")
    return host, guest


def sent(answers: Answers, seat: messages.FriendReply) -> list[bytes]:
    """Every message that a page of a seat may receive about the rally and the game."""
    about: dict[str, Any] = {"id": 1, "rally": seat.rally, "friend": messages.FriendSeat(seat.token, seat.key)}
    found = [answers(kind(**about)) for kind in (messages.RallyRequest, messages.AnalysisRequest)]
    return [*found, answers(messages.FriendRequest(id=1, token=seat.token, key=seat.key))]


def of_seat(answers: Answers, seat: messages.FriendReply) -> CourtRally:
    now = asked(answers, token=seat.token, key=seat.key)
    query = messages.RallyRequest(id=1, rally=now.rally, friend=messages.FriendSeat(seat.token, seat.key))
    return answers._played(answers._friends.seen_by(query))


def choices(policies: PolicyTables, rally: CourtRally) -> np.ndarray:
    game = policies.game
    return np.flatnonzero(game.people_positions(rally.turn)) if rally.receives else game.legal_strokes(rally.turn)


def test_no_message_depends_on_what_the_other_person_chose(policies: PolicyTables) -> None:
    """Neither the striker's messages on the position, nor the receiver's on the stroke; after both choices both are told."""
    answers, rng = Answers(policies, plan_of(), STAGER), np.random.default_rng(3)
    host, guest = begun(answers)
    hidden = {True: 0, False: 0}
    while min(hidden.values()) < 3:
        host, guest = (asked(answers, token=one.token, key=one.key) for one in (host, guest))
        views = {one.seat: (one, of_seat(answers, one)) for one in (host, guest)}
        able = [seat for seat, (_, rally) in views.items() if rally.chooses(policies.game)]
        first, second = (able[0], 1 - able[0]) if len(able) == 1 or rng.random() < 0.5 else (able[1], able[0])
        mine, theirs = views[first], views[second]
        before = sent(answers, theirs[0])
        game, chosen = answers._friends._games[host.token], {}
        at = {"rally": mine[0].rally, "stroke": len(mine[1])}
        for choice in rng.permutation(choices(policies, mine[1]))[:3].tolist() if len(able) == 2 else []:
            game.pending.clear()
            asked(answers, token=host.token, key=mine[0].key, **at, choice=choice)
            assert sent(answers, theirs[0]) == before
            hidden[mine[1].receives] += 1
            chosen[first] = choice
        if len(able) == 1:
            chosen[first] = int(rng.choice(choices(policies, mine[1])))
            asked(answers, token=host.token, key=mine[0].key, **at, choice=chosen[first])
            continue
        chosen[second] = int(rng.choice(choices(policies, theirs[1])))
        asked(answers, token=host.token, key=theirs[0].key, **at, choice=chosen[second])
        rally = answers._played(messages.RallyRequest(id=1, plan=game.plan, rally=at["rally"], person=friends._person(0)))
        striker = int(rally.striker[at["stroke"]])
        assert (int(rally.stroke[at["stroke"]]), int(rally.waited[at["stroke"]])) == (chosen[striker], chosen[1 - striker])


def test_a_seat_is_kept_and_nobody_else_takes_it(policies: PolicyTables) -> None:
    answers = Answers(policies, plan_of(), STAGER)
    host, guest = begun(answers)
    assert asked(answers, token=host.token).refused == "taken"
    assert asked(answers, token=host.token, key="guessed").refused == "taken"
    assert asked(answers, token="wrong").refused == "unknown"
    for seat in (host, guest):
        again = asked(answers, token=seat.token, key=seat.key)
        assert (again.refused, again.seat) == (None, seat.seat)
    for wrong in (messages.FriendSeat(host.token, "guessed"), messages.FriendSeat("wrong", host.key)):
        with pytest.raises(WatchError, match="open its link again"):
            answers(messages.RallyRequest(id=1, rally=0, friend=wrong))
    with pytest.raises(WatchError, match="no hints"):
        answers(messages.OptionsRequest(id=1, rally=0, friend=messages.FriendSeat(host.token, host.key)))


def test_an_absent_person_is_away_and_comes_back(policies: PolicyTables, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    answers = Answers(policies, plan_of(), STAGER)
    host, guest = begun(answers)
    clock[0] += friends.AWAY + 1
    assert asked(answers, token=host.token, key=host.key).friend == "away"
    asked(answers, token=host.token, key=guest.key)
    assert asked(answers, token=host.token, key=host.key).friend == "here"


def test_the_number_of_games_is_limited_and_forgotten_ones_make_room(
    policies: PolicyTables, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(friends, "MAX_GAMES", 3)
    games = Friends(policies)
    opened = [games.answer(messages.FriendRequest(id=1)) for _ in range(4)]
    assert [one.refused for one in opened] == [None, None, None, "full"]
    clock[0] += friends.FORGOTTEN + 1
    games.answer(messages.FriendRequest(id=1, token=opened[1].token, key=opened[1].key))
    assert games.answer(messages.FriendRequest(id=1)).refused is None
    assert games.answer(messages.FriendRequest(id=1, token=opened[0].token)).refused == "unknown"
    assert games.answer(messages.FriendRequest(id=1, token=opened[1].token)).refused is None


def test_choices_are_checked_and_count_once(policies: PolicyTables) -> None:
    answers = Answers(policies, plan_of(), STAGER)
    host, guest = begun(answers)
    server = (host, guest)[of_seat(answers, host).server]
    legal = policies.game.legal_strokes(of_seat(answers, server).turn).tolist()
    at = {"token": host.token, "key": server.key, "rally": 0}
    with pytest.raises(WatchError, match="not possible there"):
        asked(answers, **at, stroke=0, choice=max(legal) + 1)
    with pytest.raises(WatchError, match="not possible there"):
        asked(answers, token=host.token, key=(guest if server is host else host).key, rally=0, stroke=0, choice=4)
    assert asked(answers, **at, stroke=1, choice=legal[0]).strokes == 0, "of another stroke"
    assert asked(answers, **at, stroke=0, choice=legal[0]).strokes == 1 or answers._friends._games[host.token].rally.number == 1
    for wrong in ({"token": "a/b"}, {"key": "x" * 65}, {"choice": -1}, {"stroke": -1}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({"id": 1, "op": "friend", **wrong}, messages.FriendRequest)


def test_a_match_is_played_to_its_end_and_then_tells_its_plan(policies: PolicyTables) -> None:
    answers, rng = Answers(policies, plan_of(), STAGER), np.random.default_rng(0)
    host, guest = begun(answers)
    while host.plan is None:
        for seat in (host, guest):
            rally = of_seat(answers, seat)
            if rally.chooses(policies.game):
                choice = int(rng.choice(choices(policies, rally)))
                asked(answers, token=seat.token, key=seat.key, rally=rally.number, stroke=len(rally), choice=choice)
        host, guest = (asked(answers, token=one.token, key=one.key) for one in (host, guest))
    last = of_seat(answers, host)
    after: Score = last.score.after(last.winner)
    assert after.over
    assert max(after.points) == host.plan.points or after.finished
    assert host.plan == guest.plan
    assert last.names == ("you", "friend")
    assert of_seat(answers, guest).names == ("friend", "you")
