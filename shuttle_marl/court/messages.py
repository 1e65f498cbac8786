"""Messages between the page and the server, as structs that validate what is received.

``python -m docs.tools.wire_types`` writes the same types in TypeScript. A request is a JSON text with a number ``id`` and an
operation ``op``. A reply is binary: the length of its JSON as 32 bits, little-endian, the JSON with the ``id`` of the request,
padded to a multiple of four bytes, then a body, such as a packed motion. See ``docs/watch.md``.
"""

import contextvars
import functools
import operator
import struct
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta, Struct

from shuttle_marl.court import WatchError
from shuttle_marl.court.plan import DUEL, MAX_RALLIES, CatalogueIndex, Person, Plan, RallyNumber, StrokeNumber, Tried
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES

Point = tuple[float, float, float]
Box = tuple[float, float, float, float]  # a rectangle on the floor: x0, x1, y0, y1 [m]
Pair = tuple[int, int]


class Request(Struct, forbid_unknown_fields=True, tag_field="op", frozen=True):
    """A request of a page, with its number."""

    id: int


_END: Final = r"(?![\s\S])"  # the end of a text, to Python and JavaScript; ``$`` is also before a last line feed to Python
Secret = Annotated[str, Meta(pattern=f"^[A-Za-z0-9_-]{{1,64}}{_END}")]


class FriendSeat(Struct, forbid_unknown_fields=True, frozen=True):
    """The seat of a person in a game of two persons: token of the game, and key of the seat, which nobody else knows."""

    token: Secret
    key: Secret


class Query(Request, kw_only=True, frozen=True):
    """A request about a rally."""

    rally: Annotated[int, Meta(ge=0, lt=1 << 40)]
    plan: Plan | None = None  # of its match; None: a recorded rally, or one of the game of two persons
    person: Person | None = None
    tried: Tried = {}  # what replaces strokes, or positions of receivers, of a recorded rally
    friend: FriendSeat | None = None  # the seat of who asks about a game of two persons, whose plan the server has

    def __post_init__(self) -> None:
        if self.plan is not None and self.rally >= MAX_RALLIES:
            raise ValueError(f"rally {self.rally}: a match has fewer than {MAX_RALLIES} rallies")


class HelloRequest(Request, tag="hello", frozen=True):
    """First request of a page."""


class RallyRequest(Query, kw_only=True, tag="rally", frozen=True):
    """Strokes and motion of a rally."""

    have: bool = False  # the page has the motion up to the branch; the reply holds the frames after it


class AnalysisRequest(Query, kw_only=True, tag="analysis", frozen=True):
    """Values of the strokes of a rally."""


class OptionsRequest(Query, kw_only=True, tag="options", frozen=True):
    """Values of the strokes between which a person chooses, or where perfect play waits."""


class StylesRequest(Query, kw_only=True, tag="styles", frozen=True):
    """Styles of both players of a rally."""


class MatchRequest(Query, kw_only=True, tag="match", frozen=True):
    """Overview of the match of a rally."""

    partial: bool = False  # it ends with that rally; matches of a person always do


class RatingRequest(Request, kw_only=True, tag="rating", frozen=True):
    """The rating of a person after a match."""

    points: Annotated[float, Meta(ge=-10_000, le=10_000)]
    deviation: Annotated[float, Meta(ge=0, le=1000)]
    volatility: Annotated[float, Meta(gt=0, le=1)]
    scores: Annotated[tuple[Annotated[float, Meta(ge=0, le=1)], ...], Meta(max_length=20_000)]  # quality of each judged decision


class FriendRequest(Request, kw_only=True, tag="friend", frozen=True):
    """A person opens a game of two persons, takes a seat in it, chooses, or asks how it stands."""

    token: Secret | None = None  # of the game; None: a new one
    key: Secret | None = None  # of the seat; None: the next free one
    rally: RallyNumber = 0
    stroke: StrokeNumber = 0
    choice: CatalogueIndex | None = None  # for this stroke: a stroke, or as the receiver a position; None: none


_HIDDEN: Final = r"\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
SHOWN: Final = contextvars.ContextVar[list[str]]("shown")  # of a connection: the hash of the inputs that its last reply gave
NAME: Final = rf"^[^{_HIDDEN}\s=+\-@][^{_HIDDEN}]*{_END}"  # no spreadsheet takes it for a formula
LONGEST_NAME: Final = 100
Name = Annotated[str, Meta(min_length=1, max_length=LONGEST_NAME, pattern=NAME)]
Count = Annotated[int, Meta(ge=0, le=100_000)]
Hand = Literal["right", "left"]
Metres = Annotated[float, Meta(ge=-30, le=30)]


class TagStroke(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A stroke of a rally that is tagged: indices of its shot type, technique, contact height and area."""

    shot: Annotated[int, Meta(ge=0, lt=len(SHOTS))]
    technique: Annotated[int, Meta(ge=0, lt=len(TECHNIQUES))]
    height: Annotated[int, Meta(ge=0, lt=len(HEIGHTS))]
    area: Annotated[int, Meta(ge=0, lt=len(AREAS))] | None


class TagRow(TagStroke, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A tagged stroke, a row of the table; the fields are columns of ``data import``."""

    match: Name
    discipline: Literal["MS", "WS"]
    rules: RulesName
    game: Count
    rally: Count
    stroke: Count
    player: Name
    opponent: Name
    hand: Hand | None
    landing_x: Metres | None
    landing_y: Metres | None
    contact_x: Metres | None
    contact_y: Metres | None
    seconds: Annotated[float, Meta(ge=0, le=100_000)]
    frame: Annotated[int, Meta(ge=0, le=10_000_000)]
    ending: Literal["out", "net", "short", "foul", "let", "landed", "misjudged"] | None
    winner: Name | None
    points: Count | None
    points_opponent: Count | None


class TagRequest(Request, kw_only=True, tag="tag", frozen=True):
    """An input of a person who tags a video, and the rows that it changed."""

    at: Count  # number of inputs before it
    input: Annotated[str, Meta(max_length=1000)] | None  # as JSON; None: the last one is undone
    first: Count  # number of the first row that changed; those from there on are replaced
    rows: Annotated[tuple[TagRow, ...], Meta(max_length=400)]
    only_rows: bool = False  # no input is added
    after: Annotated[str, Meta(max_length=64)] | None = None  # hash of the inputs before; None: that which the last reply gave


class SuggestRequest(Request, tag="suggest", frozen=True):
    """Shot types that probably follow the strokes of a rally."""

    line: Annotated[tuple[TagStroke, ...], Meta(max_length=300)]
    receivers: tuple[Hand, Hand] = ("right", "right")  # hands of who receives the serve, and of the server


class CourtFacts(Struct):
    """Dimensions of the court [m], as in :mod:`shuttle_marl.game.court`."""

    length: float
    width: float
    half_length: float
    half_width: float
    short_service: float
    long_service: float
    net_height: float
    net_height_centre: float
    net_depth: float
    tape: float
    line: float


class AreaFacts(Struct):
    """A target area in the frame of the striker [m]."""

    name: str
    box: tuple[tuple[float, float], tuple[float, float]]


class PositionFacts(Struct):
    """A position as a right-handed player sees it, in their own frame, and the place where they stand in it [m]."""

    box: tuple[tuple[float, float], tuple[float, float]]
    place: tuple[float, float]


class RacketFacts(Struct):
    """Dimensions of a racket [m]."""

    sweet_spot: float
    butt: float
    head: tuple[float, float]


class ShuttleFacts(Struct):
    """Dimensions of a shuttle [m]; ends of a feather: distance from the axis, half width, distance behind the cork."""

    scale: float
    cork: float
    feathers: int
    feather: tuple[Point, Point]


class AthleteFacts(Struct):
    """Skeleton of an athlete: rest positions [m], parents of bones, axes of the racket, rotations of the fingers."""

    height: float
    parents: list[int]
    rest: list[Point]
    shaft: Point
    strings: Point
    fingers: dict[str, tuple[float, float, float, float]]


class HallFacts(Struct):
    """Dimensions and vocabulary for drawing."""

    court: CourtFacts
    areas: list[AreaFacts]
    positions: list[PositionFacts]
    racket: RacketFacts
    shuttle: ShuttleFacts
    bones: list[str]
    athletes: dict[str, dict[str, AthleteFacts]]
    shots: list[str]
    heights: list[str]
    techniques: list[str]


class RecordedMatch(Struct):
    """An annotated match: its first rally, event, players and date."""

    first: int
    title: str
    names: tuple[str, str]
    date: str | None
    missing: int  # number of its rallies that the data do not hold


class RecordedFacts(Struct):
    """Recorded rallies that the server shows; ``matches``: of annotated ones, in the order of their rallies."""

    title: str
    count: int
    first: int
    matches: list[RecordedMatch]


class TagFacts(Struct):
    """The video that is tagged."""

    video: str
    out: str  # name of the table
    inputs: list[str]  # so far, as JSON
    rows: int  # number of saved rows
    after: str  # hash of the inputs
    name: str  # pattern of the names that the table takes
    longest_name: int
    rules: RulesName  # of the match, unless its inputs say others


class Hello(Struct):
    """Reply to :class:`HelloRequest`."""

    hall: HallFacts
    policies: list[str]
    plan: Plan
    recorded: RecordedFacts | None
    ladder: list[str]  # opponents of duels, the weakest first
    rallies: int | None = None  # of a match in a site; None: a server plays them
    tag: TagFacts | None = None
    duel: int = DUEL


class StrokeFacts(Struct, kw_only=True):
    """A stroke of the catalogue, and the area at which it aims, as a right-handed receiver sees it; ``box``: where it lies."""

    stroke: int
    seat: int
    shot: str
    area: str
    height: str
    technique: str
    box: Box


class Stroke(StrokeFacts, kw_only=True):
    """A stroke of a rally."""

    state: int
    p_succ: float
    p_ret: float
    person: bool
    hurried: bool  # its striker was late or stretched
    waited: int | None  # position of its receiver; None: they had no choice, or it is not known
    effort: int | None
    support: float | None
    time: float
    contact: Point
    end: str
    end_time: float
    end_point: Point
    speed: float  # launch speed of the staged flight [m/s]


class TurnStroke(StrokeFacts, kw_only=True):
    """A stroke that a person may choose."""

    p_succ: float
    p_ret: float
    support: float | None  # number of real strokes behind it; None: unknown


class Turn(Struct):
    """A choice of a person: of a stroke, or of the position in which they wait for one of the opponent."""

    seat: int
    number: int
    height: str  # at which who strikes meets the shuttle
    hurried: bool  # who strikes is late or stretched
    strokes: list[TurnStroke]  # the legal strokes; empty where a position is chosen
    positions: list[float]  # probabilities of people's positions, 0: not feasible; empty where a stroke is chosen


class ScoreFacts(Struct):
    """The score after a rally."""

    points: Pair
    games: Pair
    over: bool
    game_won: bool


class PlayerFacts(Struct):
    """Appearance of a player."""

    athlete: str
    hand: str


class RallyFacts(Struct):
    """A rally without its motion."""

    number: int
    skill: str | None  # day of the skill of a pair, empty: the last one known; None: both strike with the same probabilities
    names: tuple[str, str]
    server: int
    from_right: bool  # the server serves from the right service court
    ends_changed: bool  # seat 0 is at y > 0
    before: str  # interval or change of ends before the rally, in words; empty: neither
    points: Pair
    games: Pair
    finished: list[Pair]
    winner: int | None
    reason: str | None
    after: ScoreFacts | None
    strokes: list[Stroke]
    turn: Turn | None
    players: tuple[PlayerFacts, PlayerFacts]


class RallyReply(Struct):
    """Reply to :class:`RallyRequest`; its body is the packed motion."""

    rally: RallyFacts


class Option(StrokeFacts, kw_only=True):
    """A stroke of a decision: ``win`` if both players continue with their policies, ``best`` if both play strongly."""

    p_succ: float
    p_ret: float
    support: float | None
    win: float
    best: float
    probability: float


class Question(Struct):
    """A question about a stroke."""

    right: int  # the right answer
    wrong: list[int]  # wrong answers, the stroke played first


class Place(Struct):
    """A position of the receiver of a stroke."""

    position: int
    people: float  # probability of people's choice
    perfect: float  # probability of perfect play
    loss: float  # rallies that it loses to the best one if the striker strikes as perfect play does
    win: float  # probability that the striker wins with the stroke played, under perfect play from then on


class OpenSide(StrokeFacts, kw_only=True):
    """The stroke that gains most by where the receiver waits: rallies more than against one who waits as people do."""

    gain: float


class StrokeValue(Struct, kw_only=True):
    """Values of a stroke of a rally; ``win``, ``chosen`` and ``match`` are probabilities that seat 0 wins."""

    win: float
    chosen: float
    match: float
    probability: float
    change: (
        float | None
    )  # from what elite players choose, as in shuttle_marl.reports.rating; None: too few real strokes behind it
    quality: float | None  # beside the better stroke; None: too few real strokes behind it
    loss: float  # to the better stroke
    mark: str
    better: int
    question: Question | None
    options: list[Option]
    support: int | None  # number of real strokes behind the rarer of both; None: unknown
    places: list[Place] | None  # positions of the receiver; None: they have no choice
    open: OpenSide | None  # the open side; None: there is none, or the position is not known
    wait: bool  # whether it is asked where to wait


class Analysis(Struct):
    """Reply to :class:`AnalysisRequest`; ``factor``: share of an advantage that real matches realise, and its interval."""

    number: int
    factor: tuple[float, float, float] | None
    strokes: list[StrokeValue]
    win_after: float | None


class OptionsReply(Struct):
    """Reply to :class:`OptionsRequest`: strokes, or probabilities of positions under perfect play; the other is empty."""

    options: list[Option]
    positions: list[float]


class StyleFigure(Struct):
    """A statistic of both players beside that of imitated elite players."""

    name: str
    values: tuple[float, float]
    reference: float | None


class Styles(Struct):
    """Reply to :class:`StylesRequest`; ``strength``: fraction of rallies that each player wins against imitated elite players."""

    figures: list[StyleFigure]
    shots: list[StyleFigure]
    strength: tuple[float, float]


class MatchRally(Struct):
    """A rally of a match: probability that seat 0 wins the match and score before it, server, winner, number of strokes."""

    number: int
    win: float
    points: Pair
    games: Pair
    server: int
    winner: int
    strokes: int
    swing: float  # largest change of the probability of winning the rally by a stroke


class Moment(Struct):
    """A costly stroke."""

    rally: int
    stroke: int
    seat: int
    shot: str
    mark: str
    change: float  # of the probability of winning the rally
    cost: float | None  # in the probability of winning the match; None: too small to be shown


class MatchReply(Struct):
    """Reply to :class:`MatchRequest`; ``marks``: numbers of ``!!``, ``!``, ``?!``, ``?`` and ``??`` of both sides."""

    rallies: list[MatchRally]
    win_after: float | None
    moments: list[Moment]
    accuracy: tuple[float | None, float | None]
    marks: tuple[list[int], list[int]]


class RatingReply(Struct):
    """Reply to :class:`RatingRequest`; ``interval``: that of 95 %."""

    points: float
    deviation: float
    volatility: float
    interval: tuple[float, float]


class FriendReply(Struct, kw_only=True):
    """Reply to :class:`FriendRequest`."""

    refused: Literal["full", "unknown", "taken"] | None = None  # too many games, no such game, or both seats are taken
    token: str = ""
    key: str = ""
    seat: int = 0
    friend: Literal["absent", "here", "away"] = "absent"
    rally: int = 0
    strokes: int = 0  # so far
    chosen: bool = False  # this person has chosen for the next stroke
    plan: Plan | None = None  # of the match that is over


class Saved(Struct):
    """Reply to :class:`TagRequest`: numbers of inputs and rows that are saved, and the hash of the inputs."""

    inputs: int
    rows: int
    after: str


class Suggestion(Struct):
    """A shot type with its probability, the ways of playing it, the usual one first, and the probabilities of its targets.

    A way is twice the technique plus the height; targets are areas as a right-handed receiver sees them, given the shot.
    """

    shot: int
    probability: float
    ways: list[int]
    areas: list[float]


class Suggestions(Struct):
    """Reply to :class:`SuggestRequest`, the most probable first."""

    shots: list[Suggestion]


REPLIES: Final[Mapping[type[Request], type[Struct]]] = {  # by the type of the request
    HelloRequest: Hello,
    RallyRequest: RallyReply,
    AnalysisRequest: Analysis,
    OptionsRequest: OptionsReply,
    StylesRequest: Styles,
    MatchRequest: MatchReply,
    RatingRequest: RatingReply,
    FriendRequest: FriendReply,
    TagRequest: Saved,
    SuggestRequest: Suggestions,
}


class _Envelope(Struct):
    id: int
    op: str


_envelopes = msgspec.json.Decoder(_Envelope)
_requests: Final[msgspec.json.Decoder[Request]] = msgspec.json.Decoder(functools.reduce(operator.or_, REPLIES))


def request_id(text: str) -> int | None:
    """Number of a request; None if it cannot be read."""
    try:
        return _envelopes.decode(text).id
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None


def decode_request(text: str) -> Request:
    """Decode and validate a request. Raises WatchError: it is not a request."""
    try:
        return _requests.decode(text)
    except RecursionError as error:
        raise WatchError("a request that is nested too deeply") from error
    except (msgspec.MsgspecError, UnicodeError) as error:
        raise WatchError(f"a request that is not understood ({error}); load the page again") from error


def encode_reply(number: int | None, reply: Struct | str, parts: Sequence[bytes] = ()) -> bytes:
    """Encode a reply."""
    fields: dict[str, Any] = {"error": reply} if isinstance(reply, str) else msgspec.structs.asdict(reply)
    text = msgspec.json.encode({"id": number, **fields})
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + b"".join(parts)
