"""Tagging of a video in the page: what is recovered, how many inputs it takes, and what a crash loses.

    python -m benchmarks.tagging [--rallies N] [--kills N] [--film FILE] [--json]

A simulated match between two average players is filmed, with a break of a minute in which they walk; then a script tags the
film in Chromium while it plays. It enters the strokes that were played, as a person would: it waits until the film shows one,
and presses a key a little later. Shot types and endings are keys, with Shift where the page offers so; places are keys in one
rally and clicks in the next, with Shift where the shuttle falls; techniques and contact heights are entered only where the page
assumes others. All keys and clicks count, also those that seek, pause and play; one with Shift counts once. The corners are first
clicked in every wrong order. Then the film is tagged again, while the server is killed at random moments and started again: the
kills cost what that takes more. Both tables are imported and compared with the match: stroke by stroke, except that a stroke that
fell on the striker's own side has no target. At the end the report of a table is made.
"""

import contextlib
import dataclasses
import itertools
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import av
import numpy as np
import tyro
from playwright.sync_api import Page
from rich.console import Console
from rich.progress import track

from benchmarks.court import serving, until
from benchmarks.machine import this_machine
from docs.tools.results import show
from shuttle_marl.base.arrays import F64
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import REASONS
from shuttle_marl.game import court, default_game
from shuttle_marl.game.court import AREAS, HALF_LENGTH, WIDTH
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.watch.answers import Answers
from shuttle_marl.watch.building import build
from shuttle_marl.watch.messages import RallyFacts, RallyRequest, Stroke
from shuttle_marl.watch.plan import Plan
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.server import Server, application, bind, browser_page, hosts_of, write_video
from shuttle_marl.watch.stager import Stager

SIZE: Final = (480, 270)
FPS: Final = 10
_SHOTS: Final = dict(zip(SHOTS, "sgcldsavpknbx", strict=True))
_ENDINGS: Final = {"out": "o", "net": "t", "winner": "i"}
_REASONS: Final = {"winner": "landed"}
_NAMES: Final = ("Anna Example", "Berta Sample")
_BREAK: Final = 2
"""Number of the rally that follows a break of one minute."""
_SLOW: Final = 6
"""Factor by which the film of a rally is slowed down in the break."""
_LATE: Final = (0.15, 0.05)
"""Time after which a person presses a key, and its standard deviation [s]."""
_LATEST: Final = 1.0
"""Largest error of the time of a recovered stroke [s]."""
_LONG: Final = 5.0
"""Time without play over which a person seeks [s]."""
_WATCH: Final = """(time) => new Promise((passed) => {
  const film = document.querySelector("video");
  const late = performance.now() + 30_000; // a film that stands still is started again
  const look = () =>
    film.currentTime >= time || film.paused || performance.now() > late ? passed(film.currentTime) : requestAnimationFrame(look);
  look();
})"""
_PATIENCE: Final = 60.0
"""Time that the page or a server may take [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Film:
    """A film of rallies of a match.

    Attributes:
        path: the video.
        rallies: the rallies of the film.
        begins: ``[R]`` time at which each rally begins in the film [s].
        plane: ``[3, 3]`` homography from the picture, as fractions of its size, to the court [m].
    """

    path: Path
    rallies: list[RallyFacts]
    begins: list[float]
    plane: F64

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Fractions of the picture at which a point of the court is seen."""
        a, b, c = np.linalg.solve(self.plane, [x, y, 1.0])
        return a / c, b / c


def film(path: Path, rallies: int, seed: int, console: Console) -> Film:
    """Film the first rallies of a match; a film that exists is used again."""
    policies = PolicyTables(default_game(), ("bc",))
    plan = Plan.parse({"seed": seed, "sides": [{"policy": "bc"}, {"policy": "bc"}]})
    answers = Answers(policies, plan, Stager(("female", "female")))
    facts = [answers.rally(RallyRequest(id=0, plan=plan, rally=number))[0].rally for number in range(rallies)]
    about = path.with_suffix(".json")
    if not about.exists():
        with _served(answers) as address, contextlib.ExitStack() as stack:
            link = f"{address}?quality=lite#seed={seed}&a=bc&b=bc&rally="
            plane = _plane(f"{link}1")
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            parts = [folder / f"{number}.webm" for number in range(rallies)]
            for number, part in enumerate(track(parts, "filming", console=console)):
                write_video(f"{link}{number + 1}", part, size=SIZE, fps=FPS)
            about.write_text(json.dumps({"begins": _join(parts, path), "plane": plane.tolist()}))
    saved = json.loads(about.read_text())
    return Film(path=path, rallies=facts, begins=saved["begins"], plane=np.array(saved["plane"]))


@contextlib.contextmanager
def _served(answers: Answers) -> Iterator[str]:
    with contextlib.closing(bind("127.0.0.1", 0)) as listener:
        server = Server(application(answers, build(), hosts=hosts_of("127.0.0.1")))
        running = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        running.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
        finally:
            server.should_exit = True
            running.join()


def _plane(address: str) -> F64:
    """Homography of the camera, from four points of the picture."""
    with browser_page(SIZE, reduced_motion="reduce") as page:
        page.set_default_timeout(1000 * _PATIENCE)
        page.goto(address)
        page.locator("body[data-ready]").wait_for()
        page.evaluate("window.viewer.film()")
        seen = [(0.3, 0.7), (0.7, 0.7), (0.2, 0.95), (0.8, 0.95)]
        # A film is a copy of the court's canvas, which is not shown itself.
        page.evaluate(
            "{ const [court, copy] = document.querySelectorAll('canvas');"
            " court.getBoundingClientRect = () => copy.getBoundingClientRect(); }"
        )
        floor = [page.evaluate("([x, y]) => window.viewer.floorAt(x, y)", [u * SIZE[0], v * SIZE[1]]) for u, v in seen]
    rows, values = [], []
    for (u, v), (x, y) in zip(seen, floor, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -u * x, -v * x], [0, 0, 0, u, v, 1, -u * y, -v * y]]
        values += [x, y]
    return np.append(np.linalg.solve(rows, values), 1.0).reshape(3, 3)


def _join(parts: Sequence[Path], path: Path) -> list[float]:
    """Join films, with a break and with the noise of a camera; returns when each begins [s]."""
    noise = np.random.default_rng(0).normal(0, 3, (SIZE[1], SIZE[0], 3))
    begins, frames = [], 0
    with av.open(str(path), "w", format="webm") as container:
        stream: Any = container.add_stream("libvpx-vp9", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.options = {"crf": "30", "g": str(FPS), "deadline": "realtime", "cpu-used": "8"}
        for number, part in enumerate(parts):
            for slower, source, most in ((_SLOW, parts[0], 60 * FPS if number == _BREAK else 0), (1, part, None)):
                begins += [frames / FPS] if most is None else []
                for image in itertools.islice(_pictures(source, slower), most):
                    noisy = (image + np.roll(noise, 37 * frames, axis=(0, 1))).clip(0, 255).astype(np.uint8)
                    container.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, format="rgb24")))
                    frames += 1
        container.mux(stream.encode())
    return begins


def _pictures(path: Path, slower: int) -> Iterator[F64]:
    """Pictures of a film, and between two of them what makes it slower."""
    with av.open(str(path)) as read:
        pictures = (image.to_ndarray(format="rgb24").astype(float) for image in read.decode(video=0))
        for before, after in itertools.pairwise(pictures):
            yield from (before + i / slower * (after - before) for i in range(slower))


class Script:
    """Enters the strokes of the film as the page asks for them; continues after a crash.

    Attributes:
        inputs: keys and clicks.
        chords: of them, those with Shift.
        seeks: of them, those that seek over the break.
        refused: of the 23 wrong orders of the corners, how many are refused.
        first: of each stroke, whether the first suggestion was its shot type.
    """

    def __init__(self, page: Page, played: Film) -> None:
        self.page, self._film = page, played
        self.inputs = self.chords = self.seeks = self.refused = 0
        self._rng = np.random.default_rng(0)
        self.first: dict[tuple[int, int], bool] = {}

    def state(self) -> dict[str, Any]:
        """State of the page."""
        found: dict[str, Any] = self.page.evaluate("window.viewer.state()")
        return found

    def until(self, holds: str) -> None:
        """Wait until an expression is true."""
        until(self.page, holds, _PATIENCE)

    def open(self, address: str) -> None:
        """Load the page; a new match is set up and the corners of the court are clicked."""
        self.page.goto(address)
        self.until("window.viewer && window.viewer.state().ready")
        self.until("document.querySelector('video').readyState > 0")
        if self.state()["phase"] != "setup":
            self._press(" ")
            return
        for name, value in zip(("near", "far"), _NAMES, strict=True):
            self.page.fill(f"[name={name}]", value)
        self.page.select_option("[name=server]", str(self._film.rallies[0].server))
        self.page.select_option("[name=discipline]", "WS")
        self.page.click("text=Begin")
        self.inputs += 1
        x, y = WIDTH / 2, HALF_LENGTH
        corners = ((-x, -y), (x, -y), (x, y), (-x, y))
        for order in sorted(itertools.permutations(range(4)), reverse=True):  # the right one is the last
            before = self.inputs
            for corner in order:
                self._click(*self._film.pixel(*corners[corner]))
            if self.state()["corners"] < len(corners):
                self.refused += 1
                self.inputs = before
                while self.state()["corners"]:
                    self.page.keyboard.press("Backspace")
                self.page.click("text=corners")

    def _press(self, key: str) -> None:
        self.page.keyboard.press(key)
        self.inputs += 1

    def _click(self, u: float, v: float, of: str = "video") -> None:
        box = self.page.locator(of).bounding_box()
        assert box is not None
        self.page.mouse.click(box["x"] + u * box["width"], box["y"] + v * box["height"])
        self.inputs += 1

    def _watch(self, moment: float, *, serve: bool = False) -> None:
        """Watch the film until a moment, and until a person presses a key."""
        at = float(self.page.evaluate("document.querySelector('video').currentTime"))
        if serve and moment - at > _LONG:
            self._press("PageDown")
            at = float(self.page.evaluate("document.querySelector('video').currentTime"))
            if not 0 < moment - at < _LONG:
                self._click((moment - 2) / float(self.page.evaluate("document.querySelector('video').duration")), 0.5, ".scrub")
        while at > moment + 0.5:  # missed
            self._press("ArrowLeft")
            at -= 1
        while self.page.evaluate(_WATCH, moment) < moment:
            self._press(" ")
        self.page.wait_for_timeout(1000 * max(0.0, self._rng.normal(*_LATE)))

    def step(self) -> bool:
        """Enter one thing; False when all rallies are entered."""
        state = self.state()
        number, count, last = state["rally"] - 1, state["strokes"], state["last"]
        if number == len(self._film.rallies):
            return False
        rally = self._film.rallies[number]
        if state["phase"] == "ask":
            self._press("Enter")
            return True
        if last is not None and _way(rally.strokes[count - 1]) != len(HEIGHTS) * last["technique"] + last["height"]:
            self._press("q")
            return True
        if state["phase"] == "place":
            self._place(number, count - 1)
        elif count == len(rally.strokes):
            self._press(_ENDINGS[rally.strokes[-1].end])
        else:
            self._shot(number, count)
        return True

    def _shot(self, number: int, count: int) -> None:
        stroke, before = self._film.rallies[number].strokes[count], self.inputs
        if count == 0:
            self._watch(self._film.begins[number] + stroke.time, serve=True)
            self.seeks += self.inputs - before if number == _BREAK else 0
        self.until("window.viewer.state().suggested !== null")
        state = self.state()
        self.first.setdefault((number, count), state["suggested"][0] == stroke.shot)
        other = state["ways"].get(stroke.shot, [_way(stroke)])[0] != _way(stroke)
        self.chords += other
        self._press("Shift+" * other + _SHOTS[stroke.shot])

    def _place(self, number: int, count: int) -> None:
        rally = self._film.rallies[number]
        final = count == len(rally.strokes) - 1
        met = rally.strokes[count].end_time if final else rally.strokes[count + 1].time
        self._watch(self._film.begins[number] + met)
        if final and rally.strokes[-1].end == "net":
            self._press(_ENDINGS["net"])
            return
        near = (rally.strokes[count].seat == 0) != rally.ends_changed
        x, y = place_of(rally, count)
        if number % 2:
            if final:
                self.page.keyboard.down("Shift")
            self._click(*self._film.pixel(*((x, y) if near else (-x, -y))))
            self.page.keyboard.up("Shift")
            self.chords += final
            return
        depth, side = divmod(int(court.area_of(np.array(x), np.array(y))), 3)
        self._press(str(1 + (3 * depth + side if near else 3 * (2 - depth) + 2 - side)))


def _way(stroke: Stroke) -> int:
    return len(HEIGHTS) * TECHNIQUES.index(stroke.technique) + HEIGHTS.index(stroke.height)


def place_of(rally: RallyFacts, count: int) -> tuple[float, float]:
    """Point where a stroke was met (the middle of its area) or fell, in the frame of its striker [m]."""
    stroke = rally.strokes[count]
    if count < len(rally.strokes) - 1:
        x, y = court.area_centre(np.array(AREAS.index(stroke.area)))
        return float(x), float(y)
    sign = 1 if (stroke.seat == 0) != rally.ends_changed else -1
    return sign * stroke.end_point[0], sign * stroke.end_point[1]


def tagging(video: Path, out: Path, port: int = 0) -> contextlib.AbstractContextManager[tuple[str, subprocess.Popen[str]]]:
    """Serve the page that tags a video."""
    return serving("--tag", str(video), "--out", str(out), port=port)


def tag(played: Film, out: Path, kills: int, seed: int, console: Console) -> dict[str, Any]:
    """Tag a film; the server is killed ``kills`` times."""
    with contextlib.closing(bind("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    strokes = sum(len(rally.strokes) for rally in played.rallies)
    # About two inputs a stroke; a moment lies between an input and its reply.
    moments = set(np.random.default_rng(seed).choice(2 * strokes, kills, replace=False).tolist())
    lost: list[int] = []
    saving: list[float] = []
    with browser_page((1280, 800)) as page:
        page.set_default_timeout(1000 * _PATIENCE)
        script, steps, more = Script(page, played), 0, True
        while more:
            with tagging(played.path, out, port) as (address, process), console.status(f"tagging, {len(lost)} kills"):
                before = script.state()["inputs"] if steps else 0
                if steps:
                    page.goto("about:blank")
                script.open(address)
                if steps:
                    lost.append(before - script.state()["inputs"])
                while more := script.step():
                    steps += 1
                    if steps - 1 in moments:
                        process.send_signal(signal.SIGKILL)
                        process.wait()
                        break
                    # A person is never faster than the disk.
                    script.until("(({inputs, saved}) => inputs === saved)(window.viewer.state())")
                saving += script.state()["saving_ms"]
    found, late = recovered(played, out)
    return {
        "rallies": len(played.rallies),
        "strokes": strokes,
        "recovered": float(np.mean(found)),
        "inputs_per_stroke": script.inputs / strokes,
        "with_shift": script.chords / strokes,
        "seeks_over_break": script.seeks,
        "wrong_corners_refused": script.refused,
        "late_ms": 1000 * float(np.median(late)),
        "late_ms_95": 1000 * float(np.quantile(late, 0.95)),
        "first_suggestion": float(np.mean(list(script.first.values()))),
        "autosave_ms": float(np.median(saving)),
        "autosave_ms_95": float(np.quantile(saving, 0.95)),
        "kills": len(lost),
        "inputs_lost": max(lost, default=0),
    }


def recovered(played: Film, out: Path) -> tuple[list[bool], list[float]]:
    """Whether the imported table has each played stroke, with its time, score and ending, and how late it is [s]."""
    rows = {(row["rally"], row["stroke"]): row for row in import_matches(out).strokes.to_pylist()}
    found, late = [], []
    for number, (rally, begins) in enumerate(zip(played.rallies, played.begins, strict=True)):
        for count, stroke in enumerate(rally.strokes):
            row = rows.get((number + 1, count + 1))
            if row is None or rally.after is None:
                found.append(False)
                continue
            late.append(row["frame"] / 30 - begins - stroke.time)
            last = count == len(rally.strokes) - 1
            x, y = place_of(rally, count)
            area = None if last and stroke.end == "net" else int(court.area_of(np.array(x), np.array(y)))
            points = rally.after.points[stroke.seat], rally.after.points[1 - stroke.seat]
            found.append(
                (SHOTS[row["shot"]], TECHNIQUES[row["technique"]], HEIGHTS[row["height"]], row["area"])
                == (stroke.shot, stroke.technique, stroke.height, area)
                and row["player"] == _NAMES[stroke.seat].lower().replace(" ", "-")
                and REASONS[row["reason"]] == (_REASONS.get(stroke.end, stroke.end) if last else "returned")
                and (row["points"], row["points_opponent"]) == points
                and abs(late[-1]) < _LATEST
                and (row["landing_x"] is None or number % 2 == 0 or np.hypot(row["landing_x"] - x, row["landing_y"] - y) < 0.1)
            )
    return found, late


def main(
    *,
    rallies: int = 12,
    kills: int = 20,
    seed: int = 3,
    film_file: Annotated[Path | None, tyro.conf.arg(name="film")] = None,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Tag a film of a simulated match.

    Args:
        rallies: number of rallies.
        kills: how often the server is killed while the film is tagged again; 0: it is not.
        seed: of the match, and of the moments.
        film_file: the film (.webm), made if it does not exist; default: a temporary one.
        json_output: print JSON.
    """
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory() as name:
        begun = time.monotonic()
        played = film(film_file or Path(name) / "film.webm", rallies, seed, console)
        filmed = time.monotonic()
        table = Path(name) / "match.csv"
        result = tag(played, table, 0, seed, console)
        tagged = time.monotonic()
        report = [sys.executable, "-m", "shuttle_marl", "report", str(table), "--out", str(Path(name) / "report.html")]
        subprocess.run(report, stdout=subprocess.DEVNULL, check=True)
        result |= {"film_s": filmed - begun, "tag_s": tagged - filmed, "report_s": time.monotonic() - tagged}
        killed = tag(played, table.with_name("killed.csv"), kills, seed, console) if kills else result
        more = result["strokes"] * (killed["inputs_per_stroke"] - result["inputs_per_stroke"]) / max(1, kills)
        result |= {"recovered": min(result["recovered"], killed["recovered"]), "inputs_per_kill": more}
        result |= {name: killed[name] for name in ("kills", "inputs_lost")}
    show({**this_machine(), **result}, "tagging", as_json=json_output)


if __name__ == "__main__":
    tyro.cli(main)
