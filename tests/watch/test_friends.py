"""Games of two persons by a link: what is hidden, who has a seat, and what a server allows."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from shuttle_marl.court import WatchError, friends, messages
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.friends import Friends
from shuttle_marl.court.match import CourtRally, Match, PolicyTables
from shuttle_marl.court.messages import FriendReply, FriendRequest, FriendSeat, RallyFacts, RallyRequest
from tests.watch.conftest import replied
from tests.watch.test_positions import plan_of


def asked(answers: Answers, **fields: Any) -> FriendReply:
    return replied(answers, FriendRequest(id=1, **fields), FriendReply)


def answered(games: Friends, **fields: Any) -> FriendReply:
    return games.answer(FriendRequest(id=1, **fields))


def begun(ask: Callable[..., FriendReply]) -> tuple[FriendReply, FriendReply]:
    """Both seats of a new game."""
    host = ask()
    guest = ask(token=host.token)
    assert (host.refused, host.seat, host.friend) == (None, 0, "absent")
    assert (guest.refused, guest.seat, guest.friend) == (None, 1, "here")
    return host, guest


def sent(answers: Answers, seat: FriendReply, rally: int) -> list[bytes]:
    """Every message that a page of a seat may receive about a rally and the game."""
    about: dict[str, Any] = {"id": 1, "rally": rally, "friend": FriendSeat(seat.token, seat.key)}
    found = [answers(kind(**about)) for kind in (RallyRequest, messages.AnalysisRequest)]
    return [*found, answers(FriendRequest(id=1, token=seat.token, key=seat.key))]


def shown(answers: Answers, seat: FriendReply, rally: int) -> RallyFacts:
    request = RallyRequest(id=1, rally=rally, friend=FriendSeat(seat.token, seat.key))
    return replied(answers, request, messages.RallyReply).rally


def choices(facts: RallyFacts) -> list[int]:
    """What the person of a page may choose."""
    if facts.turn is None:
        return []
    positions = np.flatnonzero(facts.turn.positions).tolist()
    return [stroke.stroke for stroke in facts.turn.strokes] or positions[: len(positions) * (len(positions) > 1)]


def test_no_message_depends_on_what_the_other_person_chose(policies: PolicyTables) -> None:
    """Neither the striker's messages on the position, nor the receiver's on the stroke; after both choices both are told."""
    answers, rng = Answers(policies, plan_of()), np.random.default_rng(3)
    seats = begun(partial(asked, answers))
    token, hidden = seats[0].token, {True: 0, False: 0}
    while min(hidden.values()) < 2:
        number = asked(answers, token=token, key=seats[0].key).rally
        facts = [shown(answers, seat, number) for seat in seats]
        at = {"rally": number, "stroke": len(facts[0].strokes)}
        able = rng.permutation([seat for seat in (0, 1) if choices(facts[seat])]).tolist()
        chosen = {seat: int(rng.choice(choices(facts[seat]))) for seat in able}
        for turn, seat in enumerate(able, 1):
            before = sent(answers, seats[1 - seat], number)
            for choice in (chosen[seat], choices(facts[seat])[0]):  # the first one counts
                asked(answers, token=token, key=seats[seat].key, **at, choice=choice)
            if turn < len(able):
                assert sent(answers, seats[1 - seat], number) == before
                hidden[bool(facts[seat].turn.strokes)] += 1
        if len(able) == 2:
            told = shown(answers, seats[0], number).strokes[at["stroke"]]
            assert (told.stroke, told.waited) == (chosen[told.seat], chosen[1 - told.seat])


def test_a_seat_is_kept_and_nobody_else_takes_it(policies: PolicyTables) -> None:
    answers = Answers(policies, plan_of())
    host, guest = begun(partial(asked, answers))
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


def test_games_are_limited_and_forgotten_ones_make_room(policies: PolicyTables, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    games = Friends(policies)
    host, guest = begun(partial(answered, games))
    clock[0] += friends.AWAY + 1
    assert answered(games, token=host.token, key=host.key).friend == "away"
    answered(games, token=host.token, key=guest.key)
    assert answered(games, token=host.token, key=host.key).friend == "here"
    others = [answered(games) for _ in range(friends.MAX_GAMES)]
    assert [one.refused for one in others] == [None] * (friends.MAX_GAMES - 1) + ["full"]
    clock[0] += friends.FORGOTTEN + 1
    answered(games, token=host.token, key=host.key)
    assert answered(games).refused is None
    assert answered(games, token=others[0].token).refused == "unknown"
    assert answered(games, token=host.token, key=host.key).refused is None


def of_seat(games: Friends, policies: PolicyTables, seat: FriendReply) -> CourtRally:
    """The rally that a seat plays."""
    now = answered(games, token=seat.token, key=seat.key)
    query = games.seen_by(RallyRequest(id=1, rally=now.rally, friend=FriendSeat(seat.token, seat.key)))
    return Match(query.plan, policies).rally(query.rally, query.person)


def test_choices_are_checked_and_count_once(policies: PolicyTables) -> None:
    games = Friends(policies)
    seats = begun(partial(answered, games))
    first = of_seat(games, policies, seats[0]).server
    server, receiver = seats[first], seats[1 - first]
    legal = policies.game.legal_strokes(of_seat(games, policies, server).turn).tolist()
    at = {"token": server.token, "key": server.key, "rally": 0}
    with pytest.raises(WatchError, match="not possible there"):
        answered(games, **at, stroke=0, choice=max(legal) + 1)
    with pytest.raises(WatchError, match="not possible there"):
        answered(games, token=server.token, key=receiver.key, rally=0, stroke=0, choice=4)
    assert answered(games, **at, stroke=1, choice=legal[0]).strokes == 0, "of another stroke"
    served = answered(games, **at, stroke=0, choice=legal[0])
    assert (served.rally, served.strokes) in ((0, 1), (1, 0))
    again = answered(games, **at, stroke=0, choice=legal[0])
    assert (again.rally, again.strokes) == (served.rally, served.strokes)


def test_a_match_is_played_to_its_end_and_then_tells_its_plan(policies: PolicyTables) -> None:
    games, rng = Friends(policies), np.random.default_rng(0)
    seats = begun(partial(answered, games))
    while seats[0].plan is None:
        for seat in seats:
            rally = of_seat(games, policies, seat)
            if rally.chooses(policies.game):
                game = policies.game
                legal = np.flatnonzero(game.people_positions(rally.turn)) if rally.receives else game.legal_strokes(rally.turn)
                about = {"rally": rally.number, "stroke": len(rally), "choice": int(rng.choice(legal))}
                answered(games, token=seat.token, key=seat.key, **about)
        first, second = (answered(games, token=one.token, key=one.key) for one in seats)
        seats = first, second
    last = of_seat(games, policies, seats[0])
    after = last.score.after(last.winner)
    assert after.over
    assert max(after.points) == seats[0].plan.points or after.finished
    assert seats[0].plan == seats[1].plan
    assert last.names == ("you", "friend")
    assert of_seat(games, policies, seats[1]).names == ("friend", "you")
