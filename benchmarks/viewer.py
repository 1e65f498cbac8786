"""Performance of the live court: page size, time to the first picture, frame time, response time, many viewers, memory.

    python -m benchmarks.viewer [--quick] [--json]

The server runs in a separate process, the browser is headless (software rendering, unless the machine has a GPU).
Needs the extra ``video`` and Chromium.
"""

import contextlib
import gzip
import json
import os
import re
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import tyro
from playwright.sync_api import Page
from websockets.sync.client import connect

from docs.tools.results import Json, show, this_machine
from shuttle_marl.court.building import FILES, build
from shuttle_marl.court.server import browser_page

_VIEWERS: Final = 50
_WIDTH, _HEIGHT = 1680, 980


@contextlib.contextmanager
def serving(*flags: str, cache: str | None = None) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Address and process of a server, which keeps compiled code in a folder, or where it usually does."""
    command = [sys.executable, "-m", "shuttle_marl.watch", "--no-browser", "--port", "0", *flags]
    env = None if cache is None else {**os.environ, "NUMBA_CACHE_DIR": cache}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=env) as process:
        assert process.stderr is not None
        try:
            for line in process.stderr:
                if found := re.match(r"(http://\S+/) shows", line):
                    yield found[1], process
                    return
            raise RuntimeError("the server did not start")
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def until(page: Page, script: str, seconds: float = 120.0) -> None:
    """Wait until an expression of the page is true."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"!!({script})"):
        if time.monotonic() > end:
            raise TimeoutError(f"waited in vain for {script}; the page says {page.inner_text('body')[:500]}")
        page.wait_for_timeout(10)


def size() -> dict[str, float]:
    """Kilobytes of the built page, plain and gzipped."""
    folder = build()
    contents = [(folder / name).read_bytes() for name in FILES]
    return {
        "bundle_kb": round(sum(map(len, contents)) / 1000, 1),
        "gzipped_kb": round(sum(len(gzip.compress(content, 9)) for content in contents) / 1000, 1),
    }


def site() -> dict[str, float]:
    """Megabytes of a whole match as a site of static files."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "shuttle_marl.watch", "--a", "bc", "--b", "bc", "--save-site", folder]
        subprocess.run(command, check=True, capture_output=True)
        return {"site_mb": round(sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file()) / 1e6, 1)}


def first_picture(page: Page, address: str) -> float:
    """Seconds until a page shows a rally."""
    page.goto("about:blank")
    begun = time.monotonic()
    page.goto(address)
    until(page, "window.viewer && window.viewer.state().ready && window.viewer.state().figures.draw_calls")
    return round(time.monotonic() - begun, 2)


def cold(page: Page) -> dict[str, float]:
    """Time to the first picture of a new server without any compiled code, after the browser has shown a page once."""
    with tempfile.TemporaryDirectory() as cache, serving(cache=cache) as (address, _):
        return {"cold_picture_s": first_picture(page, address)}


def frames(page: Page, address: str) -> dict[str, Any]:
    """Time to the first picture of a warm server, script time per frame, and draw calls from every camera in full quality."""
    page.goto(f"{address}#rally=1")
    until(page, "window.viewer && window.viewer.state().ready && window.viewer.state().analysis")
    first = first_picture(page, f"{address}#rally=1")
    page.keyboard.press(" ")
    page.wait_for_timeout(8000)
    script: list[float] = page.evaluate("window.viewer.state().script_ms")
    page.goto(f"{address}?quality=full#rally=1&stroke=2")
    until(page, "window.viewer && window.viewer.state().ready")
    calls = []
    for camera in "123456":
        page.keyboard.press(camera)
        page.evaluate("window.viewer.draw()")
        calls.append(page.evaluate("window.viewer.state().figures"))
    return {
        "first_picture_s": first,
        "script_ms_per_frame": round(statistics.median(script), 2),
        "frames": len(script),
        "draw_calls": max(entry["draw_calls"] for entry in calls),
        "triangles": max(entry["triangles"] for entry in calls),
    }


def turns(page: Page, address: str, count: int) -> dict[str, Any]:
    """Time from the choice of a stroke to the first frame that moves."""
    page.goto(f"{address}#seed=3&a=bc&b=bc&rally=1")
    until(page, "window.viewer && window.viewer.state().ready")
    page.keyboard.press("t")
    while len(found := page.evaluate("window.viewer.state().turn_ms")) < count:
        turn, winner, duration = page.evaluate(
            "(() => { const s = window.viewer.state(); return [s.turn, s.winner, s.duration]; })()"
        )
        if turn is not None:
            page.keyboard.press("Enter")
        else:
            page.evaluate("(t) => window.viewer.seek(t)", 1e3 if winner is None else duration - 0.02)
        page.wait_for_timeout(50)
    return {"turn_ms": round(statistics.median(found), 1), "turns": len(found)}


def rally(address: str, seed: int, number: int) -> tuple[float, bool]:
    """Request a rally as a page does; returns the seconds until the reply, and whether it contains a rally."""
    plan = {"seed": seed, "sides": [{"policy": "bc"}, {"policy": "bc"}]}
    begun = time.monotonic()
    with connect(address.replace("http", "ws") + "ws", max_size=None, proxy=None) as socket:
        socket.send(json.dumps({"id": 1, "op": "rally", "plan": plan, "rally": number}))
        answer = socket.recv(timeout=120)
    assert isinstance(answer, bytes)
    (length,) = struct.unpack_from("<I", answer)
    return time.monotonic() - begun, "error" not in json.loads(answer[4 : 4 + length])


def viewers(address: str) -> dict[str, Any]:
    """Slowest of many simultaneous requests for one rally."""
    with ThreadPoolExecutor(_VIEWERS) as pool:
        seconds = [found[0] for found in pool.map(lambda _: rally(address, 77, 0), range(_VIEWERS))]
    return {"viewers": _VIEWERS, "viewers_slowest_s": round(max(seconds), 2)}


def resident(pid: int) -> float:
    """Memory of a process [MB]."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text(encoding="utf-8"))
    return round(int(found[1]) / 1000, 1) if found else float("nan")


def memory(page: Page, address: str, pid: int, matches: int, rallies: int) -> dict[str, Any]:
    """Memory of server and page after each match of a session, in which some rallies are shown."""
    server, heap = [], []
    page.goto("about:blank")
    page.goto(f"{address}#rally=1")
    until(page, "window.viewer && window.viewer.state().ready")
    for match in range(matches):
        page.evaluate("(seed) => { location.hash = `#seed=${seed}&a=bc&b=bc&rally=1`; }", 100 + match)
        until(page, f"window.viewer.state().plan.seed === {100 + match}")
        for number in range(rallies):
            page.evaluate("(number) => window.viewer.go(number)", number)
            until(page, f"window.viewer.state().rally === {number}")
        page.request_gc()
        heap.append(round(page.evaluate("performance.memory.usedJSHeapSize") / 1e6, 1))
        server.append(resident(pid))
    return {"matches": matches, "rallies_a_match": rallies, "server_mb": server, "page_mb": heap}


def run(*, quick: bool = False) -> dict[str, Any]:
    """All measurements, by key."""
    size_of_page, flag = (_WIDTH, _HEIGHT), "--enable-precise-memory-info"
    with serving("--a", "bc", "--b", "bc") as (address, server), browser_page(size_of_page, flag) as page:
        found = {**this_machine(), **size(), **site(), **frames(page, address), **turns(page, address, 5 if quick else 15)}
        found |= {**cold(page), **viewers(address), **memory(page, address, server.pid, 3 if quick else 10, 4 if quick else 20)}
    return found


def main(*, quick: bool = False, as_json: Json = False) -> None:
    """Measure and print.

    Args:
        quick: fewer turns and matches.
        as_json: print JSON instead of a table.
    """
    show(run(quick=quick), "viewer", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
