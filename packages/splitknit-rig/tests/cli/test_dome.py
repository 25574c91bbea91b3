"""``splitknit calibrate lights`` on domes: one drawn here by following rays, and two sets of
photographs of one home-made dome."""

import json

import numpy as np
import pytest

from enrolled import facts_of, refusal_of, words_of
from splitknit.io.images import write_image
from splitknit.io.light_list import read_light_list

PX_PER_MM = 8.0
ROWS, COLUMNS = 600, 1000
EYE = np.array([1.0, -2.0, 92.0])
BALLS = ((-45.0, 4.0), (44.0, -6.0))
RADIUS = 4.0
HOLDER = 0.72  # z of a ball's normal, up to where a holder reaches
RINGS = (25.0, 45.0, 70.0)  # elevation, deg; and one of 5 deg


def lights():
    """(27, 3): rings of eight, and three raking lights, on a dome of 65 mm."""
    angles = [(e, 45.0 * k + e) for e in RINGS for k in range(8)] + [
        (5.0, 120.0 * k) for k in range(3)
    ]
    elevation, azimuth = np.deg2rad(angles).T
    across = np.cos(elevation)
    return 65.0 * np.stack(
        [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1
    )


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def outline(x, y):
    """X,Y,R in pixels of a ball that lies on the ground."""
    nearer = EYE[2] / (EYE[2] - RADIUS)
    at = EYE[:2] + (np.array([x, y]) - EYE[:2]) * nearer
    column, row = (COLUMNS - 1) / 2 + at[0] * PX_PER_MM, (ROWS - 1) / 2 - at[1] * PX_PER_MM
    return f"{column:.1f},{row:.1f},{RADIUS * nearer * PX_PER_MM:.1f}"


def photographed(light, gloss, generator):
    """Light (ROWS, COLUMNS): a matt ground, perhaps with gloss, and mirrors in holders on it."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    ground = np.stack(
        [
            (columns - (COLUMNS - 1) / 2) / PX_PER_MM,
            ((ROWS - 1) / 2 - rows) / PX_PER_MM,
            np.zeros(rows.shape),
        ],
        axis=-1,
    )
    towards = light - ground
    distance = np.linalg.norm(towards, axis=-1)
    half = unit(towards / distance[..., None] + unit(EYE - ground))[..., 2]
    picture = 0.3 * light[2] * 65.0**2 / distance**3 * (1 + gloss * half**400)
    picture *= np.random.default_rng(1).uniform(0.8, 1.2, picture.shape)  # the ground's own pattern
    ray = unit(ground - EYE)
    for x, y in BALLS:
        middle = np.array([x, y, RADIUS])
        along = (middle - EYE) @ np.eye(3) @ np.moveaxis(ray, -1, 0).reshape(3, -1)
        along = along.reshape(rows.shape)
        inner = along**2 - ((middle - EYE) ** 2).sum() + RADIUS**2
        hit = inner > 0
        point = EYE + (along - np.sqrt(np.maximum(inner, 0)))[..., None] * ray
        normal = (point - middle) / RADIUS
        mirrored = ray - 2 * (ray * normal).sum(axis=-1, keepdims=True) * normal
        off = np.arccos(np.clip((mirrored * unit(light - point)).sum(axis=-1), -1, 1))
        glint = np.where(normal[..., 2] > HOLDER, np.exp(-((off / 0.04) ** 2)), 0.0)
        picture = np.where(hit, 0.01 + 2.0 * glint, picture)
    noisy = picture * 0.8 + generator.normal(0, 0.002, picture.shape)
    return np.rint(65535 * np.clip(noisy, 0, 1)).astype(np.uint16)


@pytest.fixture(scope="module", params=[0.0, 1.0], ids=["matt", "gloss"])
def dome(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dome")
    generator = np.random.default_rng(0)
    for k, light in enumerate(lights()):
        write_image(folder / f"{k:02d}.png", photographed(light, request.param, generator))
    return folder


def hidden(balls):
    """Photographs in which no ball shows a glint: their normal halves an angle too large."""
    tops = []
    for x, y in BALLS[:balls]:
        middle = np.array([x, y, RADIUS])
        tops.append(unit(unit(EYE - middle) + unit(lights() - middle))[:, 2])
    return {f"{k:02d}.png" for k in np.flatnonzero(np.max(tops, axis=0) < HOLDER)}


def words(folder, balls, *more):
    outlines = [word for ball in BALLS[:balls] for word in ("--ball", outline(*ball))]
    return ("--sphere", "chrome", "--images", folder, *outlines, "--encoding", "linear", *more)


@pytest.mark.parametrize("balls", [1, 2])
def test_balls_and_ground_give_places_within_two_millimetres(capsys, tmp_path, dome, balls):
    """Lights that glint nowhere are left out, and the list names the photographs of the others."""
    out = tmp_path / "lights.txt"
    options = words(dome, balls, "--px-per-cm", 80, "--ground", "--out", out)
    facts = facts_of(capsys, "calibrate", "lights", *options)
    assert len(set(facts["left_out"]) ^ hidden(balls)) <= 2  # one may end at the holder
    table = read_light_list(out)
    assert table.places and not {*table.names} & {*facts["left_out"]}
    truth = lights()[[int(name[:2]) for name in table.names]]
    error = np.linalg.norm(table.lights - truth, axis=1)
    interval = np.array([led["interval_mm"] for led in facts["leds"]])
    assert error.mean() < 2.0 and error.max() < 3.0
    assert (error < interval).mean() > 0.9
    assert facts["fit"]["dome_radius_mm"] == pytest.approx(65.0, abs=2.0)


def test_the_list_chooses_the_photographs_of_a_surface(capsys, tmp_path, dome):
    out = tmp_path / "lights.txt"
    options = words(dome, 2, "--px-per-cm", 80, "--ground", "--out", out)
    printed = words_of(capsys, "calibrate", "lights", *options)
    assert "lights from 2 chrome balls:" in printed and "+-" in printed
    assert "left out, as no ball shows a glint" in printed
    assert f"--lights {out} --px-per-mm 8" in printed
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    flat = np.hypot(columns - 500, rows - 300) < 80
    write_image(tmp_path / "mask.png", 255 * flat.astype(np.uint8))
    surface = "--images", dome, "--lights", out, "--mask", tmp_path / "mask.png", "--px-per-mm", 8
    more = "--encoding", "linear", "--out", tmp_path / "surface"
    assert "(not in lights.txt)" in words_of(capsys, "reconstruct", *surface, *more)
    with np.load(tmp_path / "surface" / "height.npz") as arrays:
        assert np.nanstd(arrays["height_mm"]) < 0.1


def test_one_ball_alone_gives_directions(capsys, dome):
    """The distances stay open without a second ball or the ground; without a scale as well."""
    for more in (("--px-per-cm", 80), ()):
        facts = facts_of(capsys, "calibrate", "lights", *words(dome, 1, *more))
        codes = {finding["code"] for finding in facts["findings"]}
        assert ("uncertain-distances" in codes) == bool(more)
        assert "lights-left-out" in codes and facts["leds"][0]["position_mm"] is None


@pytest.mark.parametrize(
    ("balls", "scale", "limit_deg"), [(2, (), 3.0), (1, ("--px-per-cm", 80), 8.0)]
)
def test_directions_are_from_the_middle_of_the_picture(capsys, dome, balls, scale, limit_deg):
    """The mean of what each ball's glints say is 12 to 16 deg off under near lights."""
    facts = facts_of(capsys, "calibrate", "lights", *words(dome, balls, *scale))
    truth = unit(lights()[[int(led["image"][:2]) for led in facts["leds"]]])
    directions = [led["direction"] for led in facts["leds"]]
    assert facts["leds"][0]["position_mm"] is None
    off = np.degrees(np.linalg.norm(directions - truth, axis=1))
    assert off.mean() < limit_deg


def test_an_lp_file_holds_directions_and_a_mask_may_hold_two_discs(capsys, tmp_path, dome):
    mask = np.zeros((ROWS, COLUMNS), np.uint8)
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    for ball in BALLS:
        column, row, radius = map(float, outline(*ball).split(","))
        mask[np.hypot(columns - column, rows - row) < radius] = 255
    write_image(tmp_path / "mask.png", mask)
    more = "--mask", tmp_path / "mask.png", "--px-per-cm", 80, "--out", tmp_path / "a.lp"
    facts = facts_of(capsys, "calibrate", "lights", *words(dome, 0, *more))
    assert len(facts["balls"]) == 2
    assert "directions-only" in {finding["code"] for finding in facts["findings"]}
    table = read_light_list(tmp_path / "a.lp")
    np.testing.assert_allclose(np.linalg.norm(table.lights, axis=1), 1.0, atol=1e-5)
    assert table.names == tuple(led["image"] for led in facts["leds"])
    named = *more[:-1], tmp_path / "a.dome"
    message = refusal_of(capsys, "calibrate", "lights", *words(dome, 0, *named))
    assert "would not name the photographs" in message


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (("--ball", "1,2"), "--ball must be x,y,radius"),
        (("--ground",), "--px-per-cm"),
        (("--ball", "4000,20,30", "--px-per-cm", 80), "outside"),
    ],
)
def test_outlines_and_ground_that_cannot_be_used_are_refused(capsys, dome, more, expected):
    message = refusal_of(capsys, "calibrate", "lights", *words(dome, 0, *more))
    assert expected in message


@pytest.mark.external
def test_two_sets_of_one_home_made_dome_agree(capsys, data_dir, tmp_path):
    """41 lights, two small balls in holders on black felt; raking lights were refused."""
    places = []
    outlines = {
        "birr": ("162.6,740.6,37.5", "2205,792,37.5"),
        "ammonite": ("125,771,37.5", "2166,780,37.5"),
    }
    for name, (first, second) in outlines.items():
        folder = data_dir / "dome" / name
        if not folder.is_dir():
            pytest.skip(f"{folder} is absent")
        out = tmp_path / f"{name}.json"
        options = "--sphere", "chrome", "--images", folder, "--px-per-cm", 180, "--ground"
        options += "--ball", first, "--ball", second, "--out", out
        facts = facts_of(capsys, "calibrate", "lights", *options)
        assert not facts["left_out"]
        assert json.loads(out.read_text())
        places.append([led["position_mm"] for led in facts["leds"]])
    apart = np.linalg.norm(np.subtract(*places), axis=1)
    assert apart.mean() < 5.0
