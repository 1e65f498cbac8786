"""Replies to the requests of pages, and the facts and stroke values in them.

A request names all it needs, so pages can reconnect and share links.
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Final

import msgspec
import numpy as np
from msgspec.structs import asdict, replace

from shuttle_marl import __version__, staging
from shuttle_marl.analysis.rally import Decision, Players, analyse_rally
from shuttle_marl.analysis.rally import decision as analyse_decision
from shuttle_marl.arrays import F64
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game import court
from shuttle_marl.game.draws import stream
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.pairs import AnyGame, PairGame, game_of_people, seat_names
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import RELIABLE, factor_of, least_support, real_strokes
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.policy import registry
from shuttle_marl.policy.baselines import imitation
from shuttle_marl.staging.trajectory import facing
from shuttle_marl.watch import WatchError, messages
from shuttle_marl.watch.match import CourtRally, Match, play_rally
from shuttle_marl.watch.match_log import MatchLog
from shuttle_marl.watch.overview import match_overview
from shuttle_marl.watch.plan import Plan, Side
from shuttle_marl.watch.policies import OnceCache, PolicyTables
from shuttle_marl.watch.recorded import People, Recorded
from shuttle_marl.watch.stager import Stager


def hall_facts() -> messages.HallFacts:
    """Dimensions of court, equipment and athletes, and the vocabulary of strokes."""
    return messages.HallFacts(
        court=messages.CourtFacts(
            length=court.LENGTH,
            width=court.WIDTH,
            half_length=court.HALF_LENGTH,
            half_width=court.HALF_WIDTH,
            short_service=court.SHORT_SERVICE,
            long_service_doubles=court.LONG_SERVICE,
            net=court.NET_HEIGHT,
            net_centre=court.NET_HEIGHT_CENTRE,
            net_depth=court.NET_DEPTH,
            tape=court.TAPE,
            line=court.LINE,
        ),
        areas=[messages.AreaFacts(name=name, box=court.area_box(i)) for i, name in enumerate(court.AREAS)],
        racket=messages.RacketFacts(
            length=staging.RACKET_LENGTH, sweet_spot=staging.SWEET_SPOT, butt=staging.RACKET_BUTT, head=staging.RACKET_HEAD
        ),
        shuttle=messages.ShuttleFacts(
            scale=staging.SHUTTLE_SCALE, cork=staging.CORK, feathers=staging.FEATHERS, feather=staging.FEATHER
        ),
        bones=list(staging.BONES),
        athletes={name: {hand: _athlete(name, hand == "right") for hand in ("right", "left")} for name in staging.ATHLETES},
        shots=list(SHOTS),
        heights=list(HEIGHTS),
        techniques=list(TECHNIQUES),
    )


def _athlete(name: str, right_handed: bool) -> messages.AthleteFacts:
    skeleton = staging.load_skeleton(name)
    axis, normal = skeleton.racket(right_handed=right_handed)
    fingers = staging.finger_pose(name, right_handed=right_handed)
    return messages.AthleteFacts(
        height=skeleton.height,
        parents=skeleton.parents(right_handed=right_handed).tolist(),
        rest=np.round(skeleton.rest_pose(right_handed=right_handed), 6).tolist(),
        shaft=np.round(axis, 6).tolist(),
        strings=np.round(normal, 6).tolist(),
        fingers={bone: np.round(turn, 6).tolist() for bone, turn in fingers.items()},
    )


def rounded(value: float) -> float:
    """A probability rounded to seven decimals."""
    return round(float(value), 7)


def stroke_facts(game: Layout, stroke: int, seat: int) -> messages.StrokeFacts:
    """Words of a stroke of the catalogue, and the area at which a seat aims with it."""
    catalogue, sign = game.catalogue, facing(seat)
    (x0, x1), (y0, y1) = court.area_box(int(catalogue.area[stroke]), serve=bool(catalogue.is_serve[stroke]))
    xs, ys = sorted((sign * x0, sign * x1)), sorted((sign * y0, sign * y1))
    return messages.StrokeFacts(
        stroke=stroke,
        seat=seat,
        shot=SHOTS[catalogue.shot[stroke]],
        area=court.AREAS[catalogue.area[stroke]],
        height=HEIGHTS[catalogue.height[stroke]],
        technique=TECHNIQUES[catalogue.technique[stroke]],
        box=(xs[0], xs[1], ys[0], ys[1]),
    )


def rally_facts(game: AnyGame, rally: CourtRally, motion: staging.Motion) -> messages.RallyFacts:
    """A rally without its motion: score, strokes with their probabilities, positions and times, and a person's turn."""
    winner = rally.winner
    return messages.RallyFacts(
        number=rally.number,
        skill=_skill(game),
        names=seat_names(game, rally.names),
        server=rally.server,
        points=rally.points,
        games=rally.games,
        finished=list(rally.score.finished),
        winner=winner,
        reason=None if rally.open else OUTCOMES[rally.ending],
        after=None if winner is None else _score_after(rally, winner),
        strokes=[_stroke(game, rally, motion, i, int(state)) for i, state in enumerate(rally.states(game))],
        turn=None if rally.turn is None else _turn(game, rally, rally.turn),
        players=(_player(motion, 0), _player(motion, 1)),
    )


def _skill(game: AnyGame) -> str | None:
    if not isinstance(game, PairGame):
        return None
    return "with the skill of both players" + ("" if game.date is None else f" as of {game.date}")


def _player(motion: staging.Motion, seat: int) -> messages.PlayerFacts:
    return messages.PlayerFacts(athlete=motion.skeletons[seat].name, hand=motion.handedness[seat])


def _turn(game: AnyGame, rally: CourtRally, state: int) -> messages.Turn:
    seat = (rally.server + len(rally)) % 2
    game = game.seats[seat]
    strokes = game.legal_strokes(state).tolist()
    good, returned, _ = game.stroke_probabilities(game.pair_at(state, np.arange(len(strokes))))
    legal = [
        messages.TurnStroke(**asdict(stroke_facts(game, stroke, seat)), p_succ=rounded(good[k]), p_ret=rounded(returned[k]))
        for k, stroke in enumerate(strokes)
    ]
    return messages.Turn(seat=seat, number=len(rally), height=HEIGHTS[int(game.contact(state))], strokes=legal)


def _score_after(rally: CourtRally, winner: int) -> messages.ScoreFacts:
    after = rally.score.after(winner)
    game_won = len(after.finished) > len(rally.score.finished)
    points = after.finished[-1] if game_won else after.points
    return messages.ScoreFacts(points=points, games=after.games, over=after.over, game_won=game_won)


def _stroke(game: AnyGame, rally: CourtRally, motion: staging.Motion, i: int, state: int) -> messages.Stroke:
    trajectory, stroke, game = motion.trajectory, int(rally.stroke[i]), game.seats[int(rally.striker[i])]
    pair = int(game.pair(state, stroke))
    good, returned, _ = (rounded(float(p)) for p in game.stroke_probabilities(pair))
    real = real_strokes(game)
    return messages.Stroke(
        **asdict(stroke_facts(game, stroke, int(rally.striker[i]))),
        state=state,
        p_succ=good,
        p_ret=returned,
        person=i in rally.chosen,
        effort=int(game.effort(state)) if game.levels > 1 else None,
        opponent_effort=int(game.opponent_effort(state)) if game.levels > 1 else None,
        duel=int(game.duel(state)) if game.counts_duels else None,
        support=None if real is None else round(float(real[game.base_pair_edge[pair % game.n_base_pairs]]), 1),
        time=round(float(trajectory.time[i]), 4),
        frame=int(motion.contact_frame[i]),
        contact=np.round(trajectory.contact[i], 4).tolist(),
        end=staging.ENDS[trajectory.end[i]],
        end_time=round(float(trajectory.end_time[i]), 4),
        end_point=np.round(trajectory.end_point[i], 4).tolist(),
        speed=round(float(trajectory.flight.launch_speed[i]), 2),
    )


SHOWN: Final = 8
"""Number of strokes listed for each decision."""
ELITE: Final = Side(policy="bc")
"""The imitated average elite player, the reference of all comparisons."""
_POOR, _BAD = 0.10, 0.15
"""Least regret of strokes marked ``?!`` and ``?``."""
_FINE, _RARE, _VERY_RARE = 0.002, 0.05, 0.01
"""A stroke with at most the first regret is marked ``!`` or ``!!`` if elite players choose it less often than the others."""
_SOME: Final = 100
"""Number of real strokes from which a probability is reliable."""
_MAX_STYLES: Final = 64


class StrokeValues:
    """Values of the strokes of one game.

    Args:
        policies: policies, their values and the solved game.
        at_least: real strokes behind strokes that are advised; None: :func:`shuttle_marl.game.shipped.least_support`.

    Attributes:
        game: the game.
    """

    def __init__(self, policies: PolicyTables, at_least: int | None = None) -> None:
        self._policies, self.game = policies, policies.game
        self._at_least = least_support(policies.game.seats[0]) if at_least is None else at_least
        self._styles = OnceCache(_MAX_STYLES)
        factor = factor_of(policies.game.seats[0])
        self._realised = ""
        if factor is not None:
            share, low, high = (f"{part:.0%}" for part in factor)
            self._realised = f" In real matches, {share} ({low} to {high}) of a predicted advantage was realised."

    def players(self, sides: tuple[Side, Side]) -> Players:
        """Two policies and their values against each other.

        Raises:
            PolicyError: a policy cannot be loaded.
        """
        first, second = (self._policies.table(side, seat) for seat, side in enumerate(sides))
        return Players(tables=(first, second), value=self._policies.values(sides))

    def decision(self, state: int, seat: int, players: Players) -> Decision:
        """The decision of a seat in a state."""
        return analyse_decision(self.game, state, seat, players, self._policies.solution)

    def analysis(self, rally: CourtRally, players: Players) -> messages.Analysis:
        """Values of every stroke of a rally."""
        found = analyse_rally(rally, self.game, players, rules=rally.score.rules, solution=self._policies.solution)
        strokes = zip(found.decisions, found.rank.tolist(), found.match_win.tolist(), strict=False)
        fractions: tuple[list[float], list[float]] = ([], [])
        for choice, rank in zip(found.decisions, found.rank, strict=True):
            spread = float(np.ptp(choice.optimal))
            fractions[choice.seat].append(1 - float(choice.regret[rank]) / spread if spread > 0 else 1.0)
        accuracy = [round(float(np.mean(part)), 4) if part else None for part in fractions]
        over = rally.winner is not None
        return messages.Analysis(
            number=rally.number,
            strokes=[self._stroke(choice, rank, match_win) for choice, rank, match_win in strokes],
            landings=[_landings(self.game.catalogue.area, choice) for choice in found.decisions],
            win_after=float(found.rally_win[-1]) if over else None,
            match_after=float(found.match_win[-1]) if over else None,
            accuracy=(accuracy[0], accuracy[1]),
        )

    def _stroke(self, choice: Decision, rank: int, match_win: float) -> messages.StrokeValue:
        win, chosen = choice.value, float(choice.win[rank])
        better = choice.best(self._at_least)
        regret = max(0.0, float(choice.optimal[better] - choice.optimal[rank]))
        asked = choice.best(RELIABLE)
        reliable = bool((choice.support[[rank, asked]] >= RELIABLE).all())
        return messages.StrokeValue(
            win=rounded(win if choice.seat == 0 else 1 - win),
            chosen=rounded(chosen if choice.seat == 0 else 1 - chosen),
            match=rounded(match_win),
            probability=rounded(choice.probability[rank]),
            regret=rounded(regret),
            mark=self._mark(regret, int(choice.pair[rank])),
            better=int(choice.stroke[better]),
            question=int(choice.stroke[asked]) if reliable else None,
            options=self.options(choice, always=tuple(dict.fromkeys((rank, better, asked)))),
            sure=_support_sentence(choice.support[[rank, better]]) + self._realised,
        )

    def options(self, choice: Decision, *, always: tuple[int, ...] = (), limit: int = SHOWN) -> list[messages.Option]:
        """The strokes of a decision, most probable first.

        Args:
            choice: the decision.
            always: positions that are always listed.
            limit: maximum number of strokes.
        """
        order = np.argsort(-choice.probability, kind="stable").tolist()
        listed = list(dict.fromkeys([*order[: limit - len(always)], *always, *order]))[:limit]
        return [
            messages.Option(
                **msgspec.structs.asdict(stroke_facts(self.game, int(choice.stroke[k]), choice.seat)),
                p_succ=rounded(choice.p_succ[k]),
                p_ret=rounded(choice.p_ret[k]),
                support=None if np.isnan(choice.support[k]) else round(float(choice.support[k]), 1),
                probability=rounded(choice.probability[k]),
                win=rounded(choice.win[k]),
                best=rounded(choice.optimal[k]),
                regret=rounded(choice.regret[k]),
            )
            for k in sorted(listed, key=order.index)
        ]

    def styles(self, sides: tuple[Side, Side]) -> messages.Styles:
        """Exact statistics of two players against each other, beside those of two imitated elite players."""
        return self._styles.get(sides, lambda: self._styles_of(sides))

    def _styles_of(self, sides: tuple[Side, Side]) -> messages.Styles:
        visits, elite = self._policies.visits(sides), self._policies.visits((ELITE, ELITE))
        odds = self._policies.values(sides).odds()
        mixes, reference = [visits.shot_mix(seat) for seat in (0, 1)], elite.shot_mix(0)
        endings = [_ending_rates(visits.endings(), visits.states, seat) for seat in (0, 1)]
        elite_endings = _ending_rates(elite.endings(), elite.states, 0)
        figures = [
            messages.StyleFigure("rallies won", (odds.rally, 1 - odds.rally), None),
            messages.StyleFigure("matches won", (odds.match(), 1 - odds.match()), None),
        ]
        for name, shots in (
            ("attack", ("smash", "half-smash", "net-kill")),
            ("net play", ("net-shot", "cross-court-net-shot", "block")),
        ):
            index = [SHOTS.index(shot) for shot in shots]
            first, second, third = (float(mix[index].sum()) for mix in (*mixes, reference))
            figures.append(messages.StyleFigure(name, (first, second), third))
        figures += [
            messages.StyleFigure(name, (endings[0][name], endings[1][name]), elite_endings[name]) for name in elite_endings
        ]
        order = np.argsort(-np.maximum(mixes[0], mixes[1]), kind="stable")
        shots_ = [messages.StyleFigure(SHOTS[k], (float(mixes[0][k]), float(mixes[1][k])), float(reference[k])) for k in order]
        first = self._policies.values((sides[0], ELITE)).odds().rally
        second = 1 - self._policies.values((ELITE, sides[1])).odds().rally
        return messages.Styles(figures=figures, shots=shots_, strength=(rounded(first), rounded(second)))

    def _mark(self, regret: float, pair: int) -> str:
        if regret >= _POOR:
            return "?" if regret >= _BAD else "?!"
        usual = float(self._policies.table(ELITE).probability_of(np.array([pair]))[0])
        if regret <= _FINE and usual < _RARE:
            return "!!" if usual < _VERY_RARE else "!"
        return ""


def _landings(area: np.ndarray, choice: Decision) -> tuple[list[float] | None, list[float] | None]:
    """Probability with which the striker's policy aims at each area, ``[9]``; None for the receiver."""
    aims = [round(float(p), 4) for p in np.bincount(area[choice.stroke], choice.probability, court.N_AREAS)]
    return (aims, None) if choice.seat == 0 else (None, aims)


def _ending_rates(endings: dict[str, float], states: tuple[F64, F64], seat: int) -> dict[str, float]:
    """Faults and winners of a player as fractions of their strokes, serves included."""
    strokes = float(states[seat].sum())
    return {
        "faults": endings[f"fault of player {seat}"] / strokes,
        "winners": endings[f"winner of player {seat}"] / strokes,
    }


def _support_sentence(support: F64) -> str:
    """Number of real strokes behind the comparison of a stroke with the best one."""
    if np.isnan(support).any():
        return "The number of real strokes behind these probabilities is unknown."
    least = round(float(support.min()))
    real = f"Real strokes behind the rarer of this stroke and the best one: {least:,}"
    if least < RELIABLE:
        return f"{real}; the models are not reliable here."
    return f"{real}; the models are fairly reliable here." if least < _SOME else f"{real}; the models are reliable here."


_MAX_MATCHES: Final = 64
_MAX_PACKED: Final = 8
_MAX_OVERVIEWS: Final = 16
_MAX_PAIRS: Final = 3
"""Number of games of pairs in memory, of hundreds of megabytes each."""


class Answers:
    """Answers the requests of pages.

    Args:
        policies: policies of the game.
        plan: the match of a page that names none.
        stager: stages the rallies.
        recorded: recorded rallies to show instead of matches.
        first: number of the rally that is shown first.
        log: log of the rallies that a person plays; None: not recorded.
        at_least: real strokes behind strokes that are advised, see :class:`StrokeValues`.
    """

    def __init__(
        self,
        policies: PolicyTables,
        plan: Plan,
        stager: Stager,
        *,
        recorded: Recorded | None = None,
        first: int = 0,
        log: MatchLog | None = None,
        at_least: int | None = None,
    ) -> None:
        self._game, self._policies, self._plan = policies.game, policies, plan
        self._recorded, self._first_shown = recorded, first
        self._values, self._stager, self._log = StrokeValues(policies, at_least), stager, log
        self._overviews = OnceCache(_MAX_OVERVIEWS)
        self._matches, self._packed, self._pairs = OnceCache(_MAX_MATCHES), OnceCache(_MAX_PACKED), OnceCache(_MAX_PAIRS)
        self._at_least = at_least

    def __call__(self, request: messages.Request) -> bytes:
        """The encoded reply to a request.

        Raises:
            ShuttleError: it cannot be answered.
        """
        reply, body = self._reply(request)
        return messages.encode_reply(request.id, reply, [body])

    def _reply(self, request: messages.Request) -> tuple[messages.Reply, bytes]:
        if isinstance(request, messages.HelloRequest):
            return self.hello(), b""
        if isinstance(request, messages.RallyRequest):
            return self._rally(request)
        if isinstance(request, messages.AnalysisRequest):
            return self._values_of(request).analysis(self._played(request), self._players(request)), b""
        if isinstance(request, messages.OptionsRequest):
            return self._options(request), b""
        if isinstance(request, messages.MatchRequest):
            return self.match(request), b""
        return self._styles(request), b""

    def match(self, request: messages.MatchRequest) -> messages.MatchReply:
        """Overview of a match."""
        whole = request.plan is not None and request.person is None and not request.partial
        about = replace(request, id=0, rally=0 if whole else request.rally)
        found: messages.MatchReply = self._overviews.get(msgspec.json.encode(about), lambda: self._overview(about))
        return found

    def rally_facts(self, request: messages.RallyRequest) -> messages.RallyFacts:
        """A rally without its motion."""
        return self._rally(request)[0].rally

    def warm(self) -> None:
        """Compute the first rally and its analysis, so that no page waits for them."""
        plan = None if self._recorded else self._plan
        for kind in (messages.RallyRequest, messages.AnalysisRequest):
            with contextlib.suppress(ShuttleError):  # the page that asks receives the error
                self._reply(kind(id=0, plan=plan, rally=self._first_shown))

    def hello(self) -> messages.Hello:
        """Reply to the first request of a page: the hall, the policies, and the rallies that are shown."""
        recorded = self._recorded
        return messages.Hello(
            version=__version__,
            game=self._game.hash[:12],
            hall=hall_facts(),
            policies=list(dict.fromkeys([*(side.policy for side in self._plan.sides), *registry.names(self._game.seats[0])])),
            plan=self._plan,
            recorded=None if recorded is None else messages.RecordedFacts(recorded.title, recorded.count, self._first_shown),
        )

    def _rally(self, request: messages.RallyRequest) -> tuple[messages.RallyReply, bytes]:
        rally = self._played(request)
        motion = self._motion(request, rally)
        if self._log is not None and request.plan is not None and request.person is not None:
            self._log.add(request.plan, rally)
        # A page that has the motion up to the branch needs only the frames after it.
        first = self._first_frame(request, rally, motion) if request.have else 0
        packed: bytes = self._packed.get((motion, first), lambda: motion.pack(first))
        return messages.RallyReply(rally_facts(self._values_of(request).game, rally, motion)), packed

    def _options(self, query: messages.Query) -> messages.OptionsReply:
        rally = self._played(query)
        if rally.turn is None:
            raise WatchError("the rally is over; there is nothing to choose")
        values = self._values_of(query)
        choice = values.decision(rally.turn, (rally.server + len(rally)) % 2, self._players(query))
        return messages.OptionsReply(values.options(choice, limit=len(choice.stroke)))

    def _overview(self, query: messages.MatchRequest) -> messages.MatchReply:
        def analysed() -> Iterator[tuple[CourtRally, Players, messages.Analysis]]:
            for rally in self._rallies_of(query):
                one = replace(query, rally=rally.number)
                players = self._players(one)
                yield rally, players, self._values_of(one).analysis(rally, players)

        return match_overview(analysed())

    def _rallies_of(self, query: messages.MatchRequest) -> Iterator[CourtRally]:
        """Finished rallies of a match in their order."""
        ends = query.partial or query.person is not None
        number = 0 if self._recorded is None or query.plan is not None else _first_of(self._recorded, query.rally)
        before: CourtRally | None = None
        while query.plan is not None or self._recorded is None or number < self._recorded.count:
            rally = self._played(replace(query, rally=number, tried={}))
            if rally.winner is None or (before is not None and not _continues(before, rally)):
                return
            yield rally
            if rally.score.after(rally.winner).over or (ends and number >= query.rally):
                return
            before, number = rally, number + 1

    def _styles(self, query: messages.Query) -> messages.Styles:
        if query.plan is None:
            raise WatchError("styles exist for policies only; request them for a match")
        return self._values.styles(query.plan.sides_in(query.rally))

    def _played(self, query: messages.Query) -> CourtRally:
        if (plan := query.plan) is not None:
            match = self._matches.get(plan.key, lambda: Match(plan, self._game, self._policies))
            return match.rally(query.rally, query.person)
        if self._recorded is None:
            raise WatchError("this server shows no recorded rallies; load the page again")
        rally = self._recorded.rally(query.rally)
        if not query.tried:
            return rally
        k = min(query.tried)
        first, second = self._players(query).tables
        if first is None or second is None:
            raise WatchError("the policies of this rally are unknown; no stroke can be tried")
        chosen = {**dict(enumerate(rally.stroke[:k].tolist())), **query.tried}
        about = rally.number, rally.names, rally.score
        branch = play_rally(self._values_of(query).game, (first, second), stream(rally.key, k), about, chosen)
        return dataclasses.replace(branch, key=rally.key, chosen=tuple(sorted(query.tried)))

    def _players(self, query: messages.Query) -> Players:
        if query.plan is not None:
            return self._values.players(query.plan.sides_in(query.rally))
        found = None if self._recorded is None else self._recorded.players(query.rally)
        if found is not None:
            return found
        values = self._values_of(query)
        if isinstance(values.game, PairGame):
            first, second = map(imitation, values.game.players, values.game.seats)
            return values.players((Side(policy=first), Side(policy=second)))
        # Rallies of unknown players have the values of imitated elite players.
        return values.players((ELITE, ELITE))

    def _values_of(self, query: messages.Query) -> StrokeValues:
        """Values of strokes in the game of the two people who played a real rally, if the model has their skill."""
        people = None if query.plan is not None or self._recorded is None else self._recorded.people(query.rally)
        if people is None or isinstance(self._game, PairGame):
            return self._values
        found: StrokeValues = self._pairs.get(people, lambda: self._values_of_people(people))
        return found

    def _values_of_people(self, people: People) -> StrokeValues:
        game = game_of_people(self._game.seats[0], people.names, people.date)
        return self._values if game is None else StrokeValues(PolicyTables(game), self._at_least)

    def _motion(self, query: messages.Query, rally: CourtRally) -> staging.Motion:
        def compute() -> staging.Motion:
            branch = _branch(query, rally)
            if branch is None:
                return self._stager.stage(rally)
            before, stroke = branch
            return self._stager.stage(rally, self._motion(before, self._played(before)), stroke)

        return self._stager.cached(rally, query.person, compute)

    def _first_frame(self, query: messages.Query, rally: CourtRally, motion: staging.Motion) -> int:
        """First frame that differs from the motion that this one continues."""
        branch = _branch(query, rally)
        if branch is None:
            return 0
        before, stroke = branch
        if stroke:
            return int(motion.contact_frame[stroke - 1]) + 1
        return len(self._motion(before, self._played(before)).time)


def _continues(before: CourtRally, rally: CourtRally) -> bool:
    """Whether a rally is a later one of the same match."""
    earlier, later = ((sum(one.games), sum(one.points)) for one in (before, rally))
    return before.names == rally.names and earlier < later


def _first_of(recorded: Recorded, number: int) -> int:
    """Number of the first rally of the match of a rally."""
    while number > 0 and _continues(recorded.rally(number - 1), recorded.rally(number)):
        number -= 1
    return number


def _branch(query: messages.Query, rally: CourtRally) -> tuple[messages.Query, int] | None:
    """The rally whose motion a rally continues, and the first stroke that differs; None: it continues none."""
    plan, person = query.plan, query.person
    if plan is None:
        if not query.tried:
            return None
        last = max(query.tried)
        return replace(query, tried={k: stroke for k, stroke in query.tried.items() if k != last}), last
    if rally.chosen:
        return replace(query, plan=plan.without(query.rally, rally.chosen[-1])), rally.chosen[-1]
    if person is not None and person.rally == query.rally and rally.turn is not None and person.stroke:
        return replace(query, person=None), len(rally)
    return None
