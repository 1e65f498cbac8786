"""Positions on the court: hidden on the wire until the opponent strikes, chosen by a person, and recorded."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from shuttle_marl.court import WatchError, match, messages
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.match import CourtRally, Match, MatchLog, PolicyTables
from shuttle_marl.court.plan import Person, Plan, Side
from shuttle_marl.court.recorded import LogRallies, RealRallies
from shuttle_marl.court.values import ELITE, StrokeValues
from shuttle_marl.game.draws import CHOICE_ONE, draw, stream
from shuttle_marl.game.rally import stepper_of
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.reader import check
from shuttle_marl.reports.rally import decision, legal_states
from tests.watch.conftest import replied

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
SIDES = (Side(policy="bc"), Side(policy="minimax"))
PERSON = Person(seat=0, rally=0, stroke=0)


def plan_of(**fields: Any) -> Plan:
    return Plan(seed=4, sides=SIDES, **fields)


def sent(answers: Answers, plan: Plan, rally: int) -> list[bytes]:
    """Every message about a rally in which a person has to choose, as the page asks for it."""
    about: dict[str, Any] = {"id": 1, "plan": plan, "rally": rally, "person": PERSON}
    kinds = (messages.RallyRequest, messages.AnalysisRequest, messages.OptionsRequest)
    return [answers(kind(**about)) for kind in kinds]


def with_choice(plan: Plan, rally: CourtRally, game: Game, rng: np.random.Generator) -> Plan:
    """The plan with something that a person may choose at the turn of a rally."""
    kind = "waited" if rally.receives else "chosen"
    choices = np.flatnonzero(game.people_positions(rally.turn)) if rally.receives else game.legal_strokes(rally.turn)
    found = getattr(plan, kind)
    chosen = {**found.get(rally.number, {}), len(rally): int(rng.choice(choices))}
    return msgspec.structs.replace(plan, **{kind: {**found, rally.number: chosen}})


def played(policies: PolicyTables, seed: int, rallies: int = 8) -> Iterator[tuple[Plan, CourtRally]]:
    """Every turn of a person who chooses at random, and every finished rally."""
    rng, plan = np.random.default_rng(seed), plan_of()
    for number in range(rallies):
        rally = Match(plan, policies).rally(number, PERSON)
        yield plan, rally
        while rally.turn is not None:
            plan = with_choice(plan, rally, policies.game, rng)
            rally = Match(plan, policies).rally(number, PERSON)
            yield plan, rally


def test_no_message_depends_on_what_is_hidden_at_a_turn(policies: PolicyTables, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the opponent draws for the stroke of a turn, every message is the same; after the choice the page is told."""

    def told_with(number: int, plan: Plan, rally: CourtRally) -> tuple[list[bytes], int]:
        """The messages with a draw of what is hidden, and what it was, as the rally tells after a choice."""
        name = "choice_draw" if rally.receives else "position_draw"
        real, hidden = getattr(match, name), draw(stream(plan.seed, 0, rally.number), len(rally))
        monkeypatch.setattr(match, name, lambda bits: np.array([number]) if (bits == hidden).all() else real(bits))
        before = sent(Answers(policies, plan), plan, rally.number)
        chosen = with_choice(plan, rally, policies.game, np.random.default_rng(1))
        following = Match(chosen, policies).rally(rally.number, PERSON)
        monkeypatch.undo()
        return before, int((following.stroke if rally.receives else following.waited)[len(rally)])

    seen, told = {False: 0, True: 0}, {False: 0, True: 0}
    for plan, rally in played(policies, seed=0, rallies=1):
        if rally.turn is not None:
            (before, after), (same, other) = (told_with(number, plan, rally) for number in (0, CHOICE_ONE - 1))
            assert before == same
            seen[rally.receives] += 1
            told[rally.receives] += after != other
    assert min(seen.values()) > 2
    assert min(told.values()) > 1, "the draw decides what is hidden"


def test_the_stroke_of_the_opponent_does_not_depend_on_where_a_person_waits(policies: PolicyTables) -> None:
    compared = 0
    for plan, rally in played(policies, seed=1):
        if rally.receives:
            at, known = len(rally), plan.waited_in(rally.number)
            feasible = np.flatnonzero(policies.game.people_positions(rally.turn))
            waits = [{**plan.waited, rally.number: {**known, at: int(position)}} for position in feasible]
            plans = [msgspec.structs.replace(plan, waited=waited) for waited in waits]
            rallies = [Match(one, policies).rally(rally.number, PERSON) for one in plans]
            assert len({int(one.stroke[at]) for one in rallies}) == 1
            assert [int(one.waited[at]) for one in rallies if one.waited[at] >= 0] == feasible.tolist()
            compared += 1
    assert compared > 5


def test_rallies_of_a_person_are_recorded_and_replayed(policies: PolicyTables, tmp_path: Path) -> None:
    log = MatchLog(tmp_path, policies)
    finished = []
    for plan, rally in played(policies, seed=2):
        log.add(plan, rally)
        finished += [rally] if rally.turn is None else []
    log.close()
    (path,) = tmp_path.glob("*.mcap")
    checked = check(path, policies.game)
    assert (checked.problems, checked.replayed, checked.rallies) == ((), True, len(finished))
    shown = LogRallies(RallyLog(path), policies.game)
    for number, rally in enumerate(finished):
        assert shown.rally(number).waited.tolist() == rally.waited.tolist()
    with RallyLog(path) as read:
        assert read.rally(0).waited.tolist() == finished[0].waited.tolist()


def test_a_position_must_be_feasible(policies: PolicyTables) -> None:
    rally = next(rally for _, rally in played(policies, seed=0) if rally.receives)
    number = rally.number
    wrong = int((policies.game.people_positions(rally.turn) == 0).argmax())
    plan = plan_of(chosen={number: dict(enumerate(rally.stroke.tolist()))}, waited={number: {len(rally): wrong}})
    with pytest.raises(WatchError, match=f"the position chosen for stroke {len(rally) + 1} is not feasible"):
        Match(plan, policies).rally(number, PERSON)
    with pytest.raises(WatchError):
        Plan.parse({**msgspec.to_builtins(plan), "waited": {"0": {"0": N_POSITIONS}}})


def test_a_plan_forgets_what_was_chosen_from_a_stroke_on() -> None:
    plan = plan_of(chosen={0: {0: 1, 2: 3}, 1: {2: 5, 4: 6}, 2: {0: 7}}, waited={0: {1: 4}, 1: {3: 1, 5: 2}})
    left = plan.without(1, 4)
    assert (left.chosen, left.waited) == ({0: {0: 1, 2: 3}, 1: {2: 5}}, {0: {1: 4}, 1: {3: 1}})
    assert plan.without(0, 0) == plan_of()


def test_values_of_strokes_are_those_against_the_positions_of_the_opponent(policies: PolicyTables) -> None:
    """So the value of a state is their mean; against people's positions it is not."""
    values = StrokeValues(policies)
    players = values.players(SIDES)
    for rally in [Match(plan_of(), policies).rally(number) for number in range(6)]:
        for state, seat in zip(legal_states(rally, policies.game)[0].tolist(), rally.striker.tolist(), strict=True):
            choice = decision(values.game, state, seat, players)
            assert choice.win @ choice.probability == pytest.approx(choice.value, abs=1e-9)


def test_perfect_play_waits_where_the_solution_does(policies: PolicyTables) -> None:
    answers, stepper, mixed = Answers(policies, plan_of()), stepper_of(policies.game), 0
    opened = 0
    for number in range(5, 9):
        rally = Match(plan_of(), policies).rally(number)
        request = messages.AnalysisRequest(id=0, plan=plan_of(), rally=number)
        values = replied(answers, request, messages.Analysis).strokes
        for state, seat, value in zip(rally.states(policies.game).tolist(), rally.striker.tolist(), values, strict=True):
            exact = policies.solution.policy[1 - seat].position_probabilities()[state]
            assert (value.places is None) == (not stepper.chooses_position(state))
            if value.places is not None:
                told = {place.position: place.perfect for place in value.places}
                assert [told.get(position, 0) for position in range(N_POSITIONS)] == pytest.approx(exact, abs=1e-6)
                assert min(place.loss for place in value.places) == 0
                mixed += max(told.values()) < 0.99
                opened += value.open is not None
    assert mixed
    assert opened


def test_real_receivers_wait_where_they_were_annotated() -> None:
    game = load_game("default:recovery")
    shown = RealRallies(SAMPLE, game)
    waited = np.concatenate([rally.waited for rally in map(shown.rally, range(30)) if rally.waited[0] >= 0])
    assert len(np.unique(waited)) > 5
    assert all((rally.waited < 0).all() for rally in map(RealRallies(SAMPLE, load_game()).rally, range(5)))


def test_a_position_is_tried_in_a_recorded_rally(policies: PolicyTables, tmp_path: Path) -> None:
    """The receiver meets the same stroke from there, and the rally goes on."""
    plan = msgspec.structs.replace(plan_of(), sides=(ELITE, ELITE))
    log = MatchLog(tmp_path, policies)
    for number in range(6):
        log.add(plan, Match(plan, policies).rally(number))
    log.close()
    recorded = LogRallies(RallyLog(next(tmp_path.glob("*.mcap"))), policies.game)
    answers, stepper = Answers(policies, plan, recorded=recorded), stepper_of(policies.game)
    changed = []
    for rally in map(recorded.rally, range(recorded.count)):
        states = enumerate(rally.states(policies.game).tolist())
        for k, state in [(k, state) for k, state in states if stepper.chooses_position(state)][:2]:
            other = next(at for at in range(N_POSITIONS) if stepper.is_feasible(state, at) and at != rally.waited[k])
            request = messages.RallyRequest(id=1, rally=rally.number, tried={k: -1 - other})
            strokes = answers.rally(request)[0].rally.strokes
            assert [one.stroke for one in strokes[: k + 1]] == rally.stroke[: k + 1].tolist()
            assert [one.waited for one in strokes[1 : k + 1]] == [*rally.waited[1:k].tolist(), other]
            assert not any(one.person for one in strokes), "no stroke was tried"
            changed.append([one.stroke for one in strokes] != rally.stroke.tolist())
    assert any(changed)
