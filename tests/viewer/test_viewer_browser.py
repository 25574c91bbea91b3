"""The page in a real Chromium: clicked through, its numbers compared with the finger's, its console silent."""

from __future__ import annotations

import json
import re
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromium import Page, PageMaker, why_not
from splitknit.io.npz import read_npz, write_npz
from splitknit.viewer import service
from splitknit_match.gallery.entry import Entry, NewCapture
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.matching.template import Template, pack
from viewer_server import Asking, started
from written_files import read_glb

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(why_not()), reason=why_not() or "there is a browser"),
]
Serve = Callable[..., Asking]


@pytest.fixture
def page() -> Iterator[PageMaker]:
    pages: list[Page] = []

    def make(*arguments: object, **named: object) -> Page:
        pages.append(Page(*arguments, **named))  # type: ignore[arg-type]
        return pages[-1]

    yield make
    for each in pages:
        each.close()


def number(page: Page, figure: str, column: int = 0) -> float:
    text = page.run(f"return document.querySelectorAll('[data-figure={figure}]')[{column}].textContent")
    return float(text.split()[0])


def test_a_finger_is_looked_at_and_measured(shown: Path, asking: Serve, page: PageMaker, tmp_path: Path) -> None:
    seen = page(1280, 800)
    seen.open(asking(shown / "metric").server.url)
    from_above = cv2.imread(str(seen.picture("surface")))
    assert seen.run("return document.title") == "metric · splitknit"
    assert seen.run("return document.documentElement.scrollHeight <= innerHeight")

    # a distance by two clicks: 240 px of the screen, by the scale bar that is drawn
    px_per_mm = seen.run(
        "const bar = document.querySelector('.scale');"
        "return parseFloat(bar.lastChild.style.width) / parseFloat(bar.textContent)"
    )
    seen.click("input[value=measure]")
    canvas = seen.find("#view-a canvas")
    from selenium.webdriver.common.action_chains import ActionChains

    for x in (-120, 120):
        ActionChains(seen.driver).move_to_element_with_offset(canvas, x, 150).click().perform()
        seen.wait(f"return document.querySelector('#x{int(x > 0)}').value !== ''")
    seen.wait("return !document.getElementById('section').hidden")
    assert number(seen, "flat_mm") == pytest.approx(240 / px_per_mm, rel=0.005)
    seen.picture("distance")

    # a section along a ray of the spiral: 60 um from valley to crest, a crest every 0.45 mm
    for name, value in (("x0", 0.6), ("y0", 3.0), ("x1", 0.6), ("y1", 8.4)):
        seen.run(f"document.getElementById('{name}').value = {value}")
    seen.click("#cut")
    seen.wait("return document.querySelector('[data-figure=flat_mm]').textContent === '5.400 mm'")
    assert number(seen, "relief_um") == pytest.approx(59.3, rel=0.06)
    assert number(seen, "ridge_period_mm") == pytest.approx(0.45, rel=0.015)
    curve = seen.run("return document.querySelector('#chart path.a').getAttribute('d')")
    assert curve.count("L") > 100
    drawn = [float(point.split()[1]) for point in curve.replace("M", "L").split("L")[1:]]
    ticks = seen.run(
        "return [...document.querySelectorAll('#chart text[text-anchor=end]')]"
        ".map((t) => [Number(t.textContent), Number(t.getAttribute('y'))]).filter(([v]) => v === v)"
    )
    (v0, y0), (v1, y1) = ticks[:2]
    assert (max(drawn) - min(drawn)) * abs((v1 - v0) / (y1 - y0)) == pytest.approx(60, rel=0.05)  # as drawn
    seen.picture("section")
    seen.choose("#curve", "height")
    assert "height" in seen.run("return document.querySelector('#chart svg').getAttribute('aria-label')")

    # colours, light, relief: the picture changes
    for colour in ("height", "relief", "normals", "albedo"):
        before = seen.run("return document.getElementById('legend').getAttribute('aria-label')")
        seen.choose("#colour", colour)
        assert seen.run("return document.getElementById('legend').getAttribute('aria-label')") != before
        time.sleep(0.5)
        seen.drawn()
        now = cv2.imread(str(seen.picture(f"colour-{colour}")))
        assert np.abs(now.astype(int) - from_above)[200:600, 300:600].mean() > 5
    seen.choose("#colour", "clay")
    seen.click("#contours")
    seen.slide("#relief", 4)
    seen.click("input[value=light]")
    ActionChains(seen.driver).move_to_element_with_offset(canvas, 0, 0).click_and_hold().move_by_offset(
        300, 0
    ).release().perform()
    assert seen.run("return document.getElementById('azimuth').valueAsNumber") == 0
    assert seen.run("return document.getElementById('elevation').valueAsNumber") < 40
    seen.drawn()
    lit = cv2.imread(str(seen.picture("light")))
    assert np.abs(lit.astype(int) - from_above)[200:600, 300:600].mean() > 5

    # the keyboard
    seen.click("input[value=turn]")
    seen.run("document.querySelector('#view-a canvas').focus()")
    seen.press("0", "\ue014", "\ue014", "\ue013", "+", "]", "c")  # right, right, up
    assert seen.run("return document.getElementById('relief').valueAsNumber") == 4.5
    assert seen.run("return document.getElementById('colour').value") == "height"
    seen.drawn()
    seen.picture("turned")
    seen.press("m", "\ue007")
    seen.wait("return document.getElementById('said').textContent.includes('A is at')")

    # detail comes where one looks closely
    seen.press("0", *"-" * 4)
    seen.wait("return Number(document.getElementById('view-a').dataset.stride) > 1")
    seen.press(*"+" * 12)
    seen.wait("return document.getElementById('view-a').dataset.stride === '1'")
    seen.drawn()
    seen.picture("near")

    # what is saved
    seen.driver.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    seen.press("0")
    seen.choose("#step", "4")
    for kind in ("png", "ply", "stl", "glb"):
        seen.click(f"#save-{kind}")
    seen.click("#csv") if seen.find("#csv").is_displayed() else None
    end = time.monotonic() + 60
    names = {"metric.png", "metric-every-4.ply", "metric-every-4.stl", "metric-every-4.glb"}
    while not names <= {file.name for file in tmp_path.iterdir()} and time.monotonic() < end:
        time.sleep(0.1)
    assert len(read_glb(tmp_path / "metric-every-4.glb").faces) > 1000
    saved = cv2.imread(str(tmp_path / "metric.png"))
    assert saved[0, 0].tolist() == [255, 255, 255]
    assert saved.std() > 10
    assert seen.complaints() == []


def test_print_and_photographs(shown: Path, asking: Serve, page: PageMaker) -> None:
    pytest.importorskip("nbis")
    seen = page(1280, 800)
    seen.open(asking(shown / "metric").server.url)
    seen.click("#tab-print")
    seen.wait("return document.getElementById('print-words').textContent.includes('endings')", "minutiae")
    seen.slide("#least", 0)
    count = seen.run("return document.querySelectorAll('#prints path:not(.halo)').length")
    words = seen.run("return document.getElementById('print-words').textContent").split()
    said = [int(word) for word in words if word.isdigit()]
    assert count == sum(said) > 0
    seen.click("#on-surface")
    seen.picture("print")
    seen.click("#show-minutiae")
    assert seen.run("return document.querySelectorAll('#prints path').length") == 0
    seen.click("#tab-photos")
    wide = "filter((i) => i.complete && i.naturalWidth === 320)"
    seen.wait(f"return [...document.querySelectorAll('#photo-grid img')].{wide}.length === 7", "photographs")
    seen.picture("photographs")
    seen.click("#photo-grid button:nth-of-type(3)")
    seen.wait("const i = document.querySelector('#photo-large img'); return i.complete && i.naturalWidth > 320")
    seen.press("\ue014")
    assert seen.run("return document.getElementById('photo-words').textContent").startswith("4 of 7")
    seen.picture("photograph")
    seen.click("#tab-surface")
    seen.drawn()
    seen.picture("minutiae")
    assert seen.complaints() == []


def test_two_results_side_by_side(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    seen.open(asking(shown / "metric", shown / "ea").server.url)
    seen.wait("return document.body.dataset.pair === 'photographs'", "the pair")
    seen.click("#across")
    seen.wait("return document.querySelectorAll('[data-figure=flat_mm]').length === 2")
    assert number(seen, "relief_um", 0) == number(seen, "relief_um", 1)  # the same finger twice
    seen.click("[data-from=left]")
    seen.drawn()
    picture = cv2.imread(str(seen.picture("side-by-side"))).astype(int)
    width = seen.run("return document.getElementById('view-a').clientWidth")
    left, right = picture[120:700, :width], picture[120:700, width + 1 : 2 * width + 1]
    assert left.std() > 10
    assert np.abs(left - right).mean() < 3  # turned together
    seen.choose("#other", "")
    seen.wait("return document.getElementById('view-b').hidden")
    seen.drawn()
    assert seen.complaints() == []


def test_a_difference_is_seen_and_measured(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    seen.open(asking(shown / "metric", shown / "ea").server.url)
    assert seen.run("return document.querySelector('#colour [value=difference]').disabled") is False or seen.wait(
        "return !document.querySelector('#colour [value=difference]').disabled"
    )
    words = seen.run("return document.getElementById('alignment').textContent")
    assert "pixel by pixel" in words and "rms 0.0 µm" in words  # the same heights twice
    seen.choose("#colour", "difference")
    seen.wait("return document.getElementById('legend').getAttribute('aria-label').includes('second − first, µm')")
    time.sleep(0.5)
    seen.drawn()
    picture = cv2.imread(str(seen.picture("difference")))[200:500, 150:300].astype(int)
    assert np.abs(picture - picture.mean(axis=2, keepdims=True)).max() <= 3  # white: none
    seen.click("#across")
    seen.wait("return !document.getElementById('section').hidden")
    seen.choose("#curve", "difference")
    assert "difference: 0.00 to 0.00 µm" in seen.run(
        "return document.querySelector('#chart svg').getAttribute('aria-label')"
    )
    assert seen.complaints() == []


def test_light_stays_with_the_camera_or_with_the_finger(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(900, 700)
    seen.open(asking(shown / "metric").server.url)

    def brightness(name: str) -> float:
        seen.drawn()
        time.sleep(0.3)
        return float(cv2.imread(str(seen.picture(name)))[200:500, 150:400].mean())

    seen.slide("#azimuth", 0)
    seen.slide("#elevation", 10)
    seen.run("document.querySelector('#view-a canvas').focus()")
    above = brightness("light-above")
    seen.press("l")
    assert seen.find("#lamp").is_selected()
    assert brightness("light-above-finger") == pytest.approx(above, abs=0.5)  # from above both are the same
    seen.click("[data-from=left]")
    behind = brightness("light-left-finger")  # the lamp is on the finger's right: its left side is dark
    seen.click("#lamp")
    assert brightness("light-left-camera") > behind + 15
    assert seen.complaints() == []


def test_a_result_without_a_scale_is_in_pixels(shown: Path, asking: Serve, page: PageMaker, tmp_path: Path) -> None:
    arrays = read_npz(shown / "metric" / "height.npz")
    pitch = float(arrays.pop("pitch_mm"))
    for name in ("height", "ridge", "shape"):
        arrays[f"{name}_px"] = arrays.pop(f"{name}_mm") / np.float32(pitch)
    write_npz(tmp_path / "height.npz", arrays)
    seen = page(900, 700)
    seen.open(asking(tmp_path).server.url)
    seen.click("#along")
    seen.wait("return !document.getElementById('section').hidden")
    seen.picture("pixels")
    page_text = seen.run("return document.body.innerText")
    assert "mm" not in re.sub(r"[a-z]mm|mm[a-z]", "", page_text) and "µm" not in page_text
    assert seen.run("return document.querySelector('.scale').textContent").endswith(" px")
    drop(seen, tmp_path)
    seen.wait("return location.hash.includes('dropped0')")
    seen.drawn()
    assert seen.run("return document.querySelector('.scale').textContent").endswith(" px")
    assert seen.complaints() == []


def test_a_specular_image_lies_on_the_surface(shown: Path, asking: Serve, page: PageMaker, tmp_path: Path) -> None:
    folder = tmp_path / "polarised"
    shutil.copytree(shown / "ea", folder)
    size = cv2.imread(str(folder / "albedo.png"), 0).shape
    cv2.imwrite(str(folder / "specular.png"), np.where(np.indices(size)[1] % 24 < 12, 255, 1).astype(np.uint8))
    seen = page(900, 700)
    seen.open(asking(folder).server.url)
    clay = cv2.imread(str(seen.picture("clay")))
    seen.choose("#colour", "specular")
    seen.wait("return document.getElementById('legend').getAttribute('aria-label').includes('specular image')")
    time.sleep(0.5)
    seen.drawn()
    striped = cv2.imread(str(seen.picture("specular")))
    middle = np.s_[250:450, 250:450]
    assert striped[middle].std() > clay[middle].std() + 40
    drop(seen, folder)
    seen.wait("return location.hash.includes('dropped0')")
    assert not seen.run("return document.querySelector('option[value=specular]').disabled")
    seen.open(asking(shown / "ea").server.url)
    assert seen.run("return document.querySelector('option[value=specular]').disabled")
    assert seen.complaints() == []


def test_keys_are_listed(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(900, 700)
    seen.open(asking(shown / "metric").server.url)
    seen.run("document.getElementById('x0').focus()")
    seen.press("?")
    assert not seen.run("return document.getElementById('help').open")  # somebody types
    seen.run("document.activeElement.blur()")
    seen.press("?")
    assert seen.run("return document.getElementById('help').open")
    assert "light" in seen.find("#help").text
    seen.press("\ue00c")
    assert not seen.run("return document.getElementById('help').open")
    seen.click("#show-help")
    assert seen.run("return document.getElementById('help').open")


def drop(seen: Page, folder: Path) -> None:
    """Drop a folder onto the middle of the page, as the desktop does."""
    data = {"items": [], "files": [str(folder)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        event = {"type": kind, "x": 300, "y": 300, "data": data}
        seen.driver.execute_cdp_cmd("Input.dispatchDragEvent", event)
        if kind == "dragOver":
            seen.picture("dropping")


SAME = """
const done = arguments[0];
const base = new URL('.', document.baseURI).href;
(async () => {
  const [{getFirst}, {about}] = await Promise.all([import(base + 'js/tiles.js'), import(base + 'js/api.js')]);
  const [there, here] = [await getFirst('0'), await getFirst('dropped0')];
  let apart = there.length === here.length ? 0 : 1e9;
  there.forEach((tile, n) => tile.fields.forEach((field, f) => field.forEach((v, k) => {
    const other = here[n].fields[f][k];
    const known = [v, other].filter((one) => one === one).length;
    apart = Math.max(apart, [0, 1e9, Math.abs(v - other)][known]);
  })));
  const answers = [];
  for (const key of ['0', 'dropped0']) {
    const {figures} = await about(key, 'section', {x0: 0.6, y0: 3, x1: 0.6, y1: 8.4});
    const {point_mm} = await about(key, 'pick', {ox: 20, oy: 2, oz: 60, dx: -0.3, dy: 0, dz: -1, relief: 3});
    const {low_mm, high_mm, relief_range_um, points, tiles, turn} = await about(key);
    answers.push({figures, point_mm, low_mm, high_mm, relief_range_um, points, tiles, turn});
  }
  done([apart, ...answers]);
})().catch((error) => done(String(error)));
"""


def test_a_dropped_folder_is_read_in_the_browser(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    server = asking(shown / "metric")
    seen.open(server.server.url)
    asked = seen.run("return performance.getEntriesByType('resource').length")
    drop(seen, shown / "metric")
    seen.wait("return location.hash.includes('dropped0')")
    seen.drawn()
    seen.picture("dropped")
    new = seen.run(f"return performance.getEntriesByType('resource').slice({asked}).map((e) => e.name)")
    assert all(url.endswith("js/dropped.js") or url.startswith("blob:") for url in new), new
    seen.choose("#colour", "normals")
    seen.click("#along")
    seen.wait("return !document.getElementById('section').hidden")
    apart, there, here = seen.driver.execute_async_script(SAME)
    assert apart < 1e-4
    assert here["tiles"] == there["tiles"] and here["points"] == there["points"]
    for name in ("low_mm", "high_mm", "point_mm", "relief_range_um"):
        assert here[name] == pytest.approx(there[name], abs=1e-3), name
    np.testing.assert_allclose(here["turn"], there["turn"], atol=1e-9)
    for name, value in here["figures"].items():
        assert value == pytest.approx(there["figures"][name], rel=0.01, abs=1e-4), name
    assert seen.run("return document.getElementById('save-ply').getAttribute('download')") == "phalange.ply"
    assert seen.find("#save-glb").is_displayed() is False
    seen.driver.refresh()
    seen.wait("return document.getElementById('trouble').textContent.includes('drop it again')")
    drop(seen, shown / "capture")
    seen.wait("return document.getElementById('trouble').textContent.includes('height.npz')")
    assert seen.complaints() == []


def test_an_empty_page_takes_a_folder_of_results(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(900, 700)
    seen.driver.get(asking().server.url)
    seen.wait("return !document.getElementById('empty').hidden")
    seen.picture("empty")
    drop(seen, shown)
    seen.wait("return document.querySelectorAll('#result-list li').length === 2")
    seen.click("#result-list button")
    seen.drawn()
    seen.choose("#other", "dropped1")
    seen.wait("return document.body.dataset.pair === 'none'")
    seen.drawn()
    seen.picture("dropped-pair")
    assert seen.complaints() == []


def test_photographs_without_a_result(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    seen.driver.get(asking(shown / "capture").server.url)
    there = "const i = document.querySelector('#photo-large img'); return i && i.complete && i.naturalWidth > 320 && "
    seen.wait(there + "document.body.dataset.state === 'ready'")
    assert [tab.text for tab in seen.driver.find_elements("css selector", "[role=tab]") if tab.is_displayed()] == [
        "Photographs"
    ]
    assert seen.find("#command").text == f"splitknit reconstruct {shown}/capture --out capture-result"
    assert not seen.find("#photo-plain").is_displayed()
    words = "return document.getElementById('photo-words').textContent"
    assert seen.run(words).startswith("1 of 7")
    seen.run("document.querySelector('#light-table figure').focus()")
    seen.press("\ue014", "\ue014")
    assert seen.run(words).startswith("3 of 7") and "light from" in seen.run(words)
    seen.slide("#photo-at", 5)
    assert seen.run(words).startswith("5 of 7")
    dot = seen.driver.find_elements("css selector", "#lights circle:not(.on)")[0]
    from selenium.webdriver.common.action_chains import ActionChains

    before = seen.run(words)
    ActionChains(seen.driver).move_to_element(dot).click().perform()
    assert seen.run(words) != before
    seen.slide("#photo-bright", 3)
    seen.wait(there + "i.style.filter === 'brightness(3)'")
    seen.picture("photographs-only")
    seen.click("#photo-play")
    before = seen.run(words)
    seen.wait(f"return document.getElementById('photo-words').textContent !== {json.dumps(before)}")
    seen.click("#photo-play")
    assert seen.complaints() == []


def test_the_first_view_is_small(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    seen.open(asking(shown / "metric").server.url)
    sizes = seen.run(
        "return [...performance.getEntriesByType('resource'), ...performance.getEntriesByType('navigation')]"
        ".filter((e) => e.responseEnd < performance.getEntriesByName('first view')[0].startTime)"
        ".map((e) => [e.name, e.transferSize, e.encodedBodySize, e.decodedBodySize])"
    )
    assert 100_000 < sum(size for _, size, _, _ in sizes) < 600_000
    assert all(packed < plain for _, _, packed, plain in sizes if plain > 2000)
    assert not any("dropped.js" in name for name, *_ in sizes)


def test_a_folder_is_chosen_from(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    server = asking(shown)
    seen.driver.get(server.server.url)
    seen.wait("return document.querySelectorAll('#result-list li').length === 2")
    seen.wait(
        "return [...document.querySelectorAll('#result-list img')].every((i) => i.complete && i.naturalWidth > 0)"
    )
    seen.picture("results")
    seen.find("#filter").send_keys("ea")
    seen.wait("return document.querySelectorAll('#result-list li').length === 1")
    seen.click("#result-list button")
    seen.drawn()
    assert seen.run("return document.title") == "ea · splitknit"
    seen.driver.back()
    seen.wait("return !document.getElementById('results').hidden")
    assert seen.complaints() == []


def test_a_telephone(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(390, 844, still=True)
    seen.open(asking(shown / "metric").server.url)
    assert seen.run("return document.documentElement.scrollWidth <= innerWidth")
    seen.picture("telephone")

    def touch(kind: str, *points: tuple[int, int]) -> None:
        where = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        seen.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": where})

    scale = "return document.querySelector('.scale').textContent + document.querySelector('.scale i').style.width"
    before, still = seen.run(scale), cv2.imread(str(seen.picture("telephone")))
    touch("touchStart", (200, 300))  # one finger turns
    for x in range(190, 90, -10):
        touch("touchMove", (x, 300))
    touch("touchEnd")
    seen.drawn()
    turned = cv2.imread(str(seen.picture("telephone-turned")))
    assert np.abs(turned.astype(int) - still)[100:450].mean() > 2
    assert seen.run(scale) == before
    touch("touchStart", (180, 300), (220, 300))  # two zoom
    for step in range(10, 90, 10):
        touch("touchMove", (180 - step, 300), (220 + step, 300))
    touch("touchEnd")
    seen.wait(f"return (() => {{ {scale} }})() !== {json.dumps(before)}")
    seen.drawn()
    seen.picture("telephone-pinched")
    seen.click("[data-from=top]")
    seen.click("#along")
    seen.wait("return !document.getElementById('section').hidden")
    seen.run("document.getElementById('measure').scrollIntoView()")
    seen.picture("telephone-section")
    for tab in ("print", "photos"):
        seen.click(f"#tab-{tab}")
        time.sleep(1)
        assert seen.run("return document.documentElement.scrollWidth <= innerWidth")
        seen.picture(f"telephone-{tab}")
    assert seen.complaints() == []


def test_everything_has_a_name(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800)
    seen.open(asking(shown / "metric", shown / "ea").server.url)
    tree = seen.driver.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    roles = {"button", "slider", "combobox", "checkbox", "radio", "spinbutton", "tab", "image", "link", "searchbox"}
    things = [node for node in tree if not node.get("ignored") and node.get("role", {}).get("value") in roles]
    nameless = [node["role"]["value"] for node in things if not node.get("name", {}).get("value")]
    assert nameless == []
    assert len(things) > 25
    unlabelled = (
        "return [...document.querySelectorAll('input, select, button')].filter((e) => !(e.labels?.length"
        " || e.textContent.trim() || e.getAttribute('aria-label'))).map((e) => e.id)"
    )
    assert seen.run(unlabelled) == []  # of all tabs


def test_text_stands_out() -> None:
    """At least 4.5 to 1, in light and in dark (WCAG 2.2, 1.4.3)."""
    style = (Path(service.__file__).parent / "static" / "style.css").read_text(encoding="utf-8")

    def luminance(colour: str) -> float:
        levels = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        return float(
            np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)
        )

    for block in re.findall(r":root \{([^}]+)\}", style):
        colours = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", block))
        pairs = [(text, under) for text in ("ink", "soft", "warn", "accent", "second") for under in ("paper", "panel")]
        pairs += [("ink", "stage"), ("soft", "stage"), ("accent-ink", "accent")]
        for pair in pairs:
            low, high = sorted(luminance(colours[name]) for name in pair)
            assert (high + 0.05) / (low + 0.05) >= 4.5, pair


def test_without_webgl_there_is_a_picture(shown: Path, asking: Serve, page: PageMaker) -> None:
    seen = page(1280, 800, "--disable-3d-apis")
    seen.driver.get(asking(shown / "metric").server.url)
    seen.wait("return document.body.dataset.state === 'ready'")
    assert "WebGL" in seen.run("return document.getElementById('trouble').textContent")
    seen.wait("const i = document.querySelector('#view-a img'); return i && i.complete && i.naturalWidth > 0")
    seen.click("#across")
    seen.wait("return !document.getElementById('section').hidden")
    seen.picture("no-webgl")


def test_a_server_that_is_gone_is_said(shown: Path, page: PageMaker) -> None:
    seen = page(900, 700)
    server, facts = started(shown / "metric")
    seen.open(facts["url"])
    server.send_signal(signal.SIGINT)
    server.communicate(timeout=60)
    seen.click("#along")
    seen.wait("return document.getElementById('trouble').textContent.includes('no longer answers')")


MARKUP = (
    "<img src=x onerror=alert(1)>", '"><script>document.title="taken"</script>', "<svg onload=alert(2)>",
    "'); alert(3); ('", "{{7*7}}${alert(4)}", "&lt;b&gt;", "\N{RIGHT-TO-LEFT OVERRIDE}gnp.eman",
)  # fmt: skip


def only_text(seen: Page, server: Asking) -> None:
    """Nothing of a name became an element, ran, or led a request away."""
    elements = (
        "script:not([src]), img[src=x], [onerror], [onload], main svg:not(#chart svg, #prints svg, #lights), #notes b"
    )
    assert seen.run("return [...document.querySelectorAll(arguments[0])].map((e) => e.outerHTML)", elements) == []
    assert seen.run("return document.title") != "taken"
    ours = f"http://127.0.0.1:{server.server.server_port}/"
    asked = seen.run("return performance.getEntriesByType('resource').map((e) => e.name)")
    assert asked and all(url.startswith((ours, f"blob:{ours}")) for url in asked)
    assert seen.complaints() == []  # what the policy stops is said there


def test_names_from_a_report_are_only_text(shown: Path, asking: Serve, page: PageMaker, tmp_path: Path) -> None:
    report = json.loads((shown / "metric" / "report.json").read_text())
    report["preset"] = MARKUP[0]
    report["warnings"] = list(MARKUP)
    report["capture"] = {
        "subject": {"id": MARKUP[1], "finger": MARKUP[2], "session": MARKUP[3]},
        "material": MARKUP[4],
        "captured_at": MARKUP[6],
    }
    report["software"] = {"name": MARKUP[0], "version": MARKUP[1]}
    names = sorted(name.replace("/", "") for name in MARKUP)
    for name in names:
        folder = tmp_path / "results" / name
        folder.mkdir(parents=True)
        for file in ("height.npz", "preview.png", "print.png"):
            (folder / file).write_bytes((shown / "metric" / file).read_bytes())
        (folder / "report.json").write_text(json.dumps(report))
    seen = page(1280, 800)
    server = asking(tmp_path / "results")
    seen.driver.get(server.server.url)
    seen.wait(f"return document.querySelectorAll('#result-list li').length === {len(names)}")
    listed = seen.run("return [...document.querySelectorAll('#result-list b')].map((b) => b.textContent)")
    plain = [name.replace("\N{RIGHT-TO-LEFT OVERRIDE}", "\N{REPLACEMENT CHARACTER}") for name in names]
    assert listed == plain
    facts = seen.run("return document.querySelector('#result-list small').textContent")
    assert all(text in facts for text in MARKUP[:4])
    only_text(seen, server)
    seen.picture("names-listed")
    for name in (MARKUP[0], MARKUP[6]):
        seen.driver.get(server.server.url)
        seen.wait(f"return document.querySelectorAll('#result-list li').length === {len(names)}")
        buttons = seen.driver.find_elements("css selector", "#result-list li button")
        seen.run("arguments[0].click()", buttons[names.index(name)])
        seen.drawn()
        assert seen.run("return [...document.querySelectorAll('#notes li')].map((li) => li.textContent)") == [
            text.replace("\N{RIGHT-TO-LEFT OVERRIDE}", "\N{REPLACEMENT CHARACTER}") for text in MARKUP
        ]
        only_text(seen, server)
    seen.picture("names")
    beside = asking(tmp_path / "results" / names[0], tmp_path / "results" / names[1])
    seen.open(beside.server.url)
    seen.wait("return document.body.dataset.pair")
    assert seen.run("return document.getElementById('title').textContent") == " | ".join(plain[:2])
    seen.click("#tab-print")
    seen.wait("return document.querySelectorAll('#prints img, #prints image').length >= 2")
    only_text(seen, beside)


def test_names_of_people_are_only_text(asking: Serve, page: PageMaker, tmp_path: Path) -> None:
    people = [name for name in MARKUP if name.isprintable()]
    with GalleryFile(tmp_path / "people.gallery") as gallery:
        gallery.add([
            NewCapture(Entry(name, "right_index", "1", "result", f"{number:064x}", 0.0), b"")
            for number, name in enumerate(people)
        ], "0" * 64)  # fmt: skip
    seen = page(1280, 800)
    server = asking(tmp_path / "people.gallery")
    seen.driver.get(server.server.url)
    seen.wait(f"return document.querySelectorAll('#people-list li').length === {len(people)}")
    assert sorted(seen.run("return [...document.querySelectorAll('#people-list h2')].map((h) => h.textContent)")) == (
        sorted(people)
    )
    only_text(seen, server)
    seen.picture("names-of-people")


def test_a_gallery(asking: Serve, page: PageMaker, tmp_path: Path) -> None:
    rows, columns = np.mgrid[:90, :70]
    level = (np.hypot(rows - 40, columns - 35) % 5 // 1.25).astype(np.uint8)
    template = Template(level, np.hypot(rows - 45, columns - 35) < 34, 0.1)
    template.level[~template.valid] = 0
    with GalleryFile(tmp_path / "people.gallery") as gallery:
        gallery.add([
            NewCapture(Entry("Ada", "right_index", "1", "result", "0" * 64, 20.0), pack(template)),
            NewCapture(Entry("Ben", "left_thumb", "1", "result", "1" * 64, 0.0), b""),
        ], "0" * 64)  # fmt: skip
    seen = page(1280, 800)
    seen.driver.get(asking(tmp_path / "people.gallery").server.url)
    seen.wait("const i = document.querySelector('#people-list img'); return i && i.complete && i.naturalWidth === 70")
    assert seen.run("return document.querySelectorAll('#people-list li').length") == 2
    assert seen.run("return [...document.querySelectorAll('[role=tab]')].filter((t) => !t.hidden).length") == 1
    seen.picture("people")
    seen.find("#people-filter").send_keys("ben")
    seen.wait("return document.querySelectorAll('#people-list li').length === 1")
    assert seen.complaints() == []
