"""Seconds and bytes from `splitknit view` to the first view of a full-resolution finger, and how fluid it is then.

python benchmarks/bench_viewer.py [--result FOLDER] [--rounds N]

Without ``--result`` a result of full resolution is made once in benchmarks/out (a finger of the twin, `ea`: what is
shown costs the same whatever made it). Page times need Chromium, its driver and the extra `browser`; the page is drawn
by the processor there, as on a machine without a graphics card. On a busy machine the processor's seconds show more
than the clock's: they are what the work needs where nobody else is at work, if it runs on one core.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

from timing import machine

OUT = Path(__file__).resolve().parent / "out"
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-background-networking", "--no-first-run",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=1280,900",
)  # fmt: skip

SENT = """
const end = performance.getEntriesByName('first view')[0].startTime;
const all = [...performance.getEntriesByType('navigation'), ...performance.getEntriesByType('resource')];
const some = all.filter((one) => one.responseEnd < end);
return ['transferSize', 'decodedBodySize'].map((key) => some.reduce((sum, one) => sum + one[key], 0) / 1e6);
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--result", type=Path, default=None, help="a result folder")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scale", type=float, default=1.0, help="of the finger that is made where none is named")
    options = parser.parse_args()
    result = options.result or make_result(options.scale)
    print(machine())
    rows: dict[str, list[float]] = {}
    browser = open_browser()
    if browser is None:
        print("\nNo page times: Chromium, chromedriver or selenium is missing.")
    facts: dict[str, float] = {}
    sent: list[float] = []
    for _ in range(options.rounds):
        server, url, started = start(result)
        spent = processor_seconds(server.pid)
        try:
            for name, seconds in server_times(url).items():
                rows.setdefault(name, []).append(seconds)
            rows.setdefault("process to address (result read)", []).append(started)
            rows.setdefault("the same, processor seconds", []).append(spent)
            if browser is not None:
                for name, seconds in page_times(browser, url).items():
                    rows.setdefault(name, []).append(seconds)
                facts = browser.execute_script("return {...document.getElementById('view-a').dataset}")
                sent = browser.execute_script(SENT)
        finally:
            server.send_signal(signal.SIGINT)
            server.wait()
        if browser is not None:
            browser.get("about:blank")
            together = rows["process to address (result read)"][-1] + rows["page: first view"][-1]
            rows.setdefault("all: process to first view", []).append(together)
    if browser is not None:
        browser.quit()
    size = sum(file.stat().st_size for file in result.iterdir() if file.is_file()) / 1e6
    points = f", {facts['points']} points in the first view" if facts else ""
    print(f"\n### {result.name}, {size:.0f} MB{points}\n\n| step | seconds, least / median |")
    print("| --- | --- |")
    if sent:
        print(f"| MB over the wire until the first view / the same unpacked | {sent[0]:.2f} / {sent[1]:.2f} |")
    for name, seconds in rows.items():
        print(f"| {name} | {min(seconds):.3f} / {statistics.median(seconds):.3f} |")


def make_result(scale: float) -> Path:
    """Simulate a finger and reconstruct it, once."""
    capture, result = OUT / f"viewer-capture-{scale:g}", OUT / f"viewer-{scale:g}"
    verb = [sys.executable, "-m", "splitknit.cli.main"]
    if not (result / "height.npz").is_file():
        simulate = [*verb, "simulate", "--scale", str(scale), "--seed", "5", "--out", str(capture), "--overwrite"]
        for command in (simulate, [*verb, "reconstruct", str(capture), "--preset", "ea", "--out", str(result)]):
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return result


def start(result: Path) -> tuple[subprocess.Popen[str], str, float]:
    """Start the server; its process, its address, and the seconds that took."""
    command = [sys.executable, "-m", "splitknit.cli.main", "view", str(result), "--no-browser", "--json"]
    begin = time.perf_counter()
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    text = ""
    while not text.endswith("}\n"):
        text += server.stdout.readline()  # type: ignore[union-attr]
    return server, json.loads(text)["url"], time.perf_counter() - begin


def processor_seconds(pid: int) -> float:
    """Seconds that a process and those it started have computed; 0 where the system does not report it (Linux does)."""
    times: dict[int, float] = {}
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = stat.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        times[int(stat.parent.name)] = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
        parents[int(stat.parent.name)] = int(words[1])
    family = {pid}
    while grown := {child for child, parent in parents.items() if parent in family} - family:
        family |= grown
    return sum(times.get(each, 0.0) for each in family)


def server_times(url: str) -> dict[str, float]:
    """Seconds of single answers."""
    paths = {
        "server: facts": "api/result/0", "server: points of the first view": "api/result/0/first",
        "server: a tile of all values": "api/result/0/tile/1/4/4",
        "server: a point under the mouse": "api/result/0/pick?ox=0&oy=0&oz=60&dx=0.2&dy=0&dz=-1&relief=3",
        "server: a section": "api/result/0/section?x0=-4&y0=0&x1=4&y1=1",
    }  # fmt: skip
    found = {}
    for name, path in paths.items():
        begin = time.perf_counter()
        with urllib.request.urlopen(url + path) as answer:
            answer.read()
        found[name] = time.perf_counter() - begin
    return found


def open_browser() -> Any:
    """Return a browser without a window, or None."""
    if importlib.util.find_spec("selenium") is None or not (shutil.which("chromium") and shutil.which("chromedriver")):
        return None
    from selenium import webdriver  # may be missing
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in FLAGS:
        options.add_argument(flag)
    browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    browser.set_script_timeout(120)
    return browser


def page_times(browser: Any, url: str) -> dict[str, float]:
    """Seconds after the page was asked for, and of a frame while the finger is turned."""
    driver = browser.service.process.pid
    before = processor_seconds(driver)
    browser.get(url)
    while browser.execute_script("return document.body.dataset.state") != "ready":
        time.sleep(0.02)
    spent = processor_seconds(driver) - before
    marks = browser.execute_script("return performance.getEntriesByType('mark').map((m) => [m.name, m.startTime])")
    found = {f"page: {name}": seconds / 1000 for name, seconds in marks}
    found["page: first view, the browser's processor seconds"] = spent
    while browser.execute_script("return document.getElementById('view-a').dataset.complete") != "true":
        time.sleep(0.02)
    found["page: all detail of the first view"] = browser.execute_script("return performance.now()") / 1000
    frames = browser.execute_async_script(
        """
        const done = arguments[0];
        const canvas = document.querySelector('#view-a canvas');
        const held = {pointerId: 1, button: 0, buttons: 1, bubbles: true, pointerType: 'mouse', isPrimary: true};
        const at = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind, {clientX: x, clientY: 300, ...held}));
        canvas.setPointerCapture = () => {};
        canvas.releasePointerCapture = () => {};
        at('pointerdown', 300);
        const times = [];
        const step = (now) => {
          times.push(now);
          if (times.length > 25) { at('pointerup', 300); done(times); return; }
          at('pointermove', 300 + 3 * times.length);
          requestAnimationFrame(step);
        };
        requestAnimationFrame(step);
        """
    )
    gaps = [later - sooner for sooner, later in itertools.pairwise(frames)]
    found["page: a frame while it is turned"] = statistics.median(gaps[5:]) / 1000
    return found


if __name__ == "__main__":
    main()
