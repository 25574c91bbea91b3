"""Near lights: inverse square, lobe, shared exposures, perspective, windows."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging import chunks
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.model import Camera, Led, Rig
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import near_light, pseudo_normals
from splitknit.photometric.robust import robust

SHAPE = (60, 80)


def axes_mm(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """x of the columns and y of the rows under parallel rays."""
    view = view_of(camera)
    return view.x_mm, view.y_mm


def make_rig(camera=None, lobe=0.0, count=7):
    angles = 2 * np.pi * np.arange(count) / count
    leds = tuple(
        Led(
            "white",
            position_mm=(52.5 * np.cos(a), 52.5 * np.sin(a), 140.0),
            intensity=1 + 0.1 * k,
            lobe_exponent=lobe,
        )
        for k, a in enumerate(angles)
    )
    return Rig(camera if camera is not None else Camera(2.0, SHAPE), leds)


def dome(x, y):
    """A cap of radius 40 mm, 12 mm high: height and normals in mm."""
    z = np.sqrt(40.0**2 - x**2 - y**2) - 28.0
    normals = np.stack([x, y, z + 28.0], axis=-1) / 40.0
    return z, normals


def point_light(led, points):
    """Light vector by the book, in double precision: d / |d|^3 times the lobe; relative to 100
    mm."""
    position = np.asarray(led.position_mm)
    to_light = position - points
    distance = np.linalg.norm(to_light, axis=-1, keepdims=True)
    cosine = (to_light @ position)[..., None] / (distance * np.linalg.norm(position))
    vector = (
        led.intensity * 1e4 * to_light / distance**3 * np.clip(cosine, 0, None) ** led.lobe_exponent
    )
    return vector + sum(point_light(part, points) for part in led.also)


def scene(rig, x=None, y=None, albedo=0.7):
    if x is None:
        x, y = axes_mm(rig.camera)
    gx, gy = np.meshgrid(x, y)
    z, normals = dome(gx, gy)
    points = np.stack([gx, gy, z], axis=-1)
    strength = np.mean([np.linalg.norm(point_light(led, np.zeros(3))) for led in rig.leds])
    stack = (
        np.stack([(point_light(led, points) * normals).sum(axis=-1) for led in rig.leds])
        * albedo
        / strength
    )
    return stack.astype(np.float32), z.astype(np.float32), normals


@pytest.mark.parametrize(("lobe", "count"), [(0.0, 7), (1.5, 7), (0.0, 3)])
def test_exact_for_the_true_surface(lobe, count):
    rig = make_rig(lobe=lobe, count=count)
    stack, z, normals = scene(rig)
    got, albedo = near_light(stack, rig, z)
    assert np.abs(got - normals).max() < 2e-4
    assert np.abs(albedo - 0.7).max() < 2e-4


def test_better_than_distant_lights_even_on_a_flat_guess():
    rig = make_rig()
    stack, z, normals = scene(rig)
    distant, _ = lambertian(stack, rig.light_vectors())
    flat, _ = near_light(stack, rig, float(z.mean()))

    def error(got):
        return np.degrees(np.arccos(np.clip((got * normals).sum(axis=-1), -1, 1))).mean()

    assert error(distant) > 2
    assert error(flat) < 0.6


def test_field_is_normalised_as_the_rigs_own_vectors():
    rig = make_rig(Camera(2.0, (1, 1)))
    field = light_vectors_at(rig, *view_of(rig.camera).points(np.zeros((1, 1), dtype=np.float32)))
    assert np.allclose(field[:, :, 0, 0], rig.light_vectors(), atol=1e-6)


def test_leds_that_share_an_exposure_add():
    single = make_rig()
    pairs = single.select([(0, 1), (1, 2), (2, 3), (4,), (5,), (6, 0)])
    stack, z, normals = scene(pairs)
    got, albedo = near_light(stack, pairs, z)
    assert np.abs(got - normals).max() < 3e-4
    assert np.abs(albedo - 0.7).max() < 3e-4


def test_distant_leds_give_the_distant_result():
    lights = np.array([[0.5, 0, 1], [-0.5, 0.1, 1], [0, 0.6, 1], [0, -0.5, 1.2]])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    rig = Rig(Camera(2.0, SHAPE), tuple(Led("white", direction=tuple(v)) for v in lights))
    _, normals = dome(*np.meshgrid(*axes_mm(rig.camera)))
    stack = np.einsum("hwi,li->lhw", normals, lights).astype(np.float32)
    got, _ = near_light(stack, rig, 0.0)
    expected, _ = lambertian(stack, lights)
    assert np.abs(got - expected).max() < 1e-4


def test_window_with_its_own_axes_gives_the_same_pixels():
    rig = make_rig()
    stack, z, _ = scene(rig)
    x, y = axes_mm(rig.camera)
    whole, _ = near_light(stack, rig, z)
    window = (slice(10, 31), slice(20, 66))
    part, _ = near_light(stack[:, *window], rig, z[window], view=View(x[window[1]], y[window[0]]))
    assert np.array_equal(part, whole[window])
    with pytest.raises(BadInput, match="`view` of a part"):
        near_light(stack[:, *window], rig, z[window])


@pytest.mark.parametrize("distortion", [None, (-0.1, 0.02, 0.001, -0.001, 0.0)])
def test_perspective_rays_pass_through_the_apex(distortion):
    rows, columns = SHAPE
    focal = 2.0 * 140
    matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]])
    rig = make_rig(Camera(2.0, SHAPE, model="perspective", matrix=matrix, distortion=distortion))
    field = light_vectors_at(rig, *view_of(rig.camera).points(np.full(SHAPE, 10, dtype=np.float32)))
    x, y = axes_mm(Camera(2.0, SHAPE))
    gx, gy = np.meshgrid(x, y)
    if distortion is not None:  # find where the distorted ray comes from, by iterating its model
        k1, k2, p1, p2, _ = distortion
        u, v = gx / 140, -gy / 140
        a, b = u.copy(), v.copy()
        for _ in range(30):
            r2 = a**2 + b**2
            radial = 1 + k1 * r2 + k2 * r2**2
            a, b = (
                (u - 2 * p1 * a * b - p2 * (r2 + 2 * a**2)) / radial,
                (v - p1 * (r2 + 2 * b**2) - 2 * p2 * a * b) / radial,
            )
        gx, gy = a * 140, -b * 140
    points = np.stack([gx * 130 / 140, gy * 130 / 140, np.full(SHAPE, 10.0)], axis=-1)
    strength = np.mean([np.linalg.norm(point_light(led, np.zeros(3))) for led in rig.leds])
    for k, led in enumerate(rig.leds):
        assert (
            np.abs(field[k].transpose(1, 2, 0) - point_light(led, points) / strength).max() < 1e-5
        )


def test_pseudo_normals_are_linear_and_share_channels():
    rig = make_rig()
    stack, z, normals = scene(rig)
    rng = np.random.default_rng(0)
    weights = rng.uniform(0.2, 1, stack.shape).astype(np.float32)
    colours = np.stack([stack, 2 * stack, rng.random(stack.shape).astype(np.float32)])
    g = pseudo_normals(colours, rig, z, weights=weights)
    assert g.shape == (3, *SHAPE, 3)
    assert np.abs(g[0] - 0.7 * normals).max() < 3e-4
    assert np.allclose(g[1], 2 * g[0], atol=1e-5)
    assert np.allclose(
        pseudo_normals(colours[0] + colours[2], rig, z, weights=weights), g[0] + g[2], atol=2e-3
    )
    assert np.array_equal(pseudo_normals(colours[2], rig, z, weights=weights), g[2])


def test_a_light_of_weight_zero_does_not_count():
    rig = make_rig()
    stack, z, normals = scene(rig)
    weights = np.ones_like(stack)
    stack[2], weights[2] = 0.5, 0.0
    assert np.abs(pseudo_normals(stack, rig, z, weights=weights) - 0.7 * normals).max() < 3e-4


def test_light_that_does_not_enter_the_surface_does_not_darken_it():
    rig = make_rig(count=3)
    stack, z, normals = scene(rig)
    entering = np.random.default_rng(0).uniform(0.5, 1, stack.shape)
    mask = np.hypot(*np.mgrid[-30:30, -40:40]) < 20
    g = pseudo_normals(entering * stack, rig, z, mask, entering=entering)
    assert np.abs(g - 0.7 * normals)[mask].max() < 3e-4
    assert not g[~mask].any()
    assert g.dtype == np.float32


def test_bytes_do_not_depend_on_the_chunks(monkeypatch):
    """Along the rays of a perspective camera, where every row has its own frames."""
    matrix = np.array([[280.0, 0, 39.5], [0, 280.0, 29.5], [0, 0, 1]])
    rig = make_rig(Camera(2.0, SHAPE, model="perspective", matrix=matrix))
    stack, view = scene(make_rig())[0], view_of(rig.camera, along_rays=True)
    mask = np.hypot(*np.mgrid[-30:30, -40:40]) < 25
    fractions = np.random.default_rng(0).uniform(0.2, 1, (2, *stack.shape)).astype(np.float32)

    def results():
        plain, _ = near_light(stack, rig, 3.0, mask, view)
        g = pseudo_normals(stack, rig, 3.0, mask, fractions[0], view=view, entering=fractions[1])
        return plain.tobytes(), g.tobytes()

    first = results()
    monkeypatch.setattr(chunks, "_pixels_per_chunk", lambda lights: 700)
    assert results() == first


def test_shadows_leave_near_lights_the_distant_result():
    """Three lights in one plane reach the surface; the two in shadow count little."""
    lights = np.array([[-0.5, 0, 1], [0, 0.01, 1], [0.5, 0, 1], [0, 0.8, 0.6], [0, -0.8, 0.6]])
    stack = np.array([1.0, 1.02, 1.0, 0.028, 0.03])[:, None, None]
    leds = (Led("white", direction=tuple(v), intensity=np.linalg.norm(v)) for v in lights)
    got, _ = near_light(stack, Rig(Camera(2.0, (1, 1)), tuple(leds)), 0.0)
    assert np.abs(got - robust(stack, lights)[0]).max() < 1e-4


def test_robust_weights_find_a_highlight():
    rig = make_rig(count=9)
    stack, z, normals = scene(rig)
    stack[2, 20:30, 30:50] *= 1.4
    got, _ = near_light(stack, rig, z)
    assert np.degrees(np.arccos(np.clip((got * normals).sum(-1), -1, 1)))[20:30, 30:50].mean() < 0.7


def test_surface_may_be_nan_outside_the_mask_only():
    rig = make_rig()
    stack, z, normals = scene(rig)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[10:50, 10:70] = True
    z[~mask] = np.nan
    for inside in (mask, None):
        got, albedo = near_light(stack, rig, z, inside)
        assert np.abs(got - normals)[mask].max() < 2e-4
        assert not got[~mask].any()
        assert np.isnan(albedo[~mask]).all()
    z[20, 20] = np.nan
    with pytest.raises(BadInput, match="inside the mask"):
        near_light(stack, rig, z, mask)


COPLANAR = Rig(
    Camera(2.0, SHAPE), tuple(Led("white", direction=(x, 0.0, 1.0)) for x in range(-3, 4))
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stack": np.ones((6, *SHAPE))}, "7 lights for 6 images"),
        ({"surface_mm": np.zeros((3, 3))}, "surface_mm must be a number"),
        ({"surface_mm": 140.0}, "reaches the LEDs"),
        ({"surface_mm": np.full(SHAPE, np.nan)}, "NaN everywhere"),
        ({"weights": np.ones((7, 3, 3))}, "weights must have the shape"),
        ({"weights": -np.ones((7, *SHAPE))}, "not negative"),
        ({"entering": np.ones((7, 3, 3))}, "entering must have the shape"),
        ({"rig": COPLANAR}, "the rig's lights are coplanar"),
        ({"view": View(np.arange(3), np.arange(4))}, r"of \(4, 3\) pixels"),
    ],
)
def test_bad_input_is_refused(change, message):
    arguments = {"stack": np.ones((7, *SHAPE)), "rig": make_rig(), "surface_mm": 0.0, **change}
    with pytest.raises(BadInput, match=message):
        pseudo_normals(**arguments)
