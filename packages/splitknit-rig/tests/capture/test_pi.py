"""What is the Raspberry Pi's alone: metadata, linear pictures, missing hardware."""

import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import gpiozero
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_contract_pi import PINS, pins  # noqa: F401 - a fixture

from fake_picamera2 import FakePicamera2, FakeRequest, World
from refusals import bad_input
from splitknit.nominal import default_rig
from splitknit_rig.capture.pi import SENSORS, PiCamera, PiCameraSettings, developed, opened_pi

SMALL = PiCameraSettings(image_size=(64, 96))


@pytest.fixture
def world(monkeypatch):
    world = World()
    monkeypatch.setattr(FakePicamera2, "world", world)
    monkeypatch.setattr(FakePicamera2, "opened", [])
    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=FakePicamera2))
    return world


def camera_in(world, settings=SMALL):
    return PiCamera(FakePicamera2, settings, now_ns=lambda: world.now_ns)


def test_the_picture_is_the_middle_of_the_sensor_without_automatic_controls(world):
    with camera_in(world, PiCameraSettings()) as camera:
        (fake,) = FakePicamera2.opened
        asked = fake.configuration
        assert camera.image_size == (2200, 3200)
        assert asked["main"] == {"size": (3200, 2200), "format": "BGR888"}
        assert asked["raw"] == {"size": (3280, 2464), "format": "SBGGR10"}
        assert asked["controls"]["ScalerCrop"] == (40, 132, 3200, 2200)
        assert asked["queue"] is False
        for name in ("AeEnable", "AwbEnable", "NoiseReductionMode", "Sharpness"):
            assert not asked["controls"][name]
        camera.lock(0.03, 2.0, "nir")
        controls = fake.asked[-1][1]
        assert controls["ExposureTime"] == 30_000
        assert controls["AnalogueGain"] == 2.0
        assert controls["ColourGains"] == (1.0, 1.0)
        assert controls["FrameDurationLimits"] == (47_700, 47_700)
        camera.lock(0.1, 1.0, "white")
        assert fake.asked[-1][1]["FrameDurationLimits"] == (101_000, 101_000)
        assert fake.asked[-1][1]["ColourGains"] == (1.11, 2.13)
    assert fake.calls == ["start", "stop", "close"]


def test_stale_frames_and_those_of_the_old_exposure_are_discarded(world):
    with camera_in(world) as camera:
        camera.lock(0.01, 1.0)
        assert camera.capture().discarded >= 3  # the new exposure comes late
        assert camera.capture().discarded <= 2
        world.sleep(1.0)  # two old frames wait in the buffers
        assert camera.capture().discarded >= 2
        camera.lock(0.01, 1.0, "nir")  # the exposure is the same, the colours are not yet
        assert camera.capture().discarded >= 3
        fake = FakePicamera2.opened[0]
        assert all(request.released for request in fake.requests)


def test_a_camera_that_ignores_its_settings_is_refused(world, monkeypatch):
    with camera_in(world) as camera:
        monkeypatch.setattr(FakePicamera2, "stuck", True)
        camera.lock(0.05, 1.0)
        with bad_input(r"did not take its settings: 50000 us at gain 1.*reports"):
            camera.capture()
        assert all(request.released for request in FakePicamera2.opened[0].requests)


@pytest.mark.parametrize("digital", [1.5, 0.5])
def test_a_digital_gain_is_refused(world, monkeypatch, digital):
    metadata = FakeRequest.get_metadata
    with camera_in(world) as camera:
        monkeypatch.setattr(
            FakeRequest, "get_metadata", lambda own: metadata(own) | {"DigitalGain": digital}
        )
        with bad_input("did not take its settings"):
            camera.capture()


def test_the_tuning_is_made_linear(world):
    with camera_in(world):
        straight = FakePicamera2.opened[0].tuning
    algorithms = {
        name: values for entry in straight["algorithms"] for name, values in entry.items()
    }
    assert "rpi.alsc" not in algorithms
    assert algorithms["rpi.contrast"] == {"ce_enable": 0, "gamma_curve": [0, 0, 65535, 65535]}
    assert np.array_equal(np.reshape(algorithms["rpi.ccm"]["ccms"][0]["ccm"], (3, 3)), np.eye(3))
    assert algorithms["rpi.black_level"] == {"black_level": 4096}


def test_a_tuning_file_of_another_version_is_refused(world, monkeypatch):
    old = {"version": 1.0, "rpi.contrast": {}}
    monkeypatch.setattr(FakePicamera2, "load_tuning_file", lambda name: old)
    with bad_input("unknown version"):
        camera_in(world)


def test_raw_images_are_developed_in_linear_colours():
    raw = np.full((32, 48), 64, dtype=np.uint16)
    raw[0::2, 0::2] += 100  # blue
    raw[0::2, 1::2] += 200  # green
    raw[1::2, 0::2] += 200
    raw[1::2, 1::2] += 300  # red
    colours = developed(raw, 10, 64 * 64, "BGGR", (1.5, 2.0))[4:-4, 4:-4]
    assert colours.dtype == np.uint16
    black = 64 * 64
    assert_allclose(colours[..., 0], black + 300 * 1.5 * 64, atol=1)
    assert_allclose(colours[..., 1], black + 200 * 64, atol=1)
    assert_allclose(colours[..., 2], black + 100 * 2.0 * 64, atol=1)
    clipped = developed(np.full((8, 8), 1023, dtype=np.uint16), 10, 64 * 64, "BGGR", (0.5, 1.0))
    assert (clipped == 65535).all()
    dark = developed(np.full((8, 8), 60, dtype=np.uint16), 10, 64 * 64, "BGGR", (2.0, 2.0))
    assert (dark < black).all()  # noise below black is kept
    assert (dark > 0).all()


def test_a_raw_frame_is_the_middle_of_the_sensor_with_its_black_level(world):
    with camera_in(world, PiCameraSettings(image_size=(64, 96), raw=True)) as camera:
        frame = camera.capture()
        assert frame.pixels.shape == (64, 96, 3)
        assert frame.pixels.dtype == np.uint16
        assert frame.black_level == 64 * 64
        middle = frame.pixels[8:-8, 8:-8].reshape(-1, 3).mean(axis=0) - frame.black_level
        assert middle[0] == pytest.approx(9 * 1.11 * 64, rel=0.05)
        assert middle[2] == pytest.approx(5 * 2.13 * 64, rel=0.05)


@pytest.mark.parametrize("order", ["BGGR", "GBRG", "GRBG", "RGGB"])
def test_colours_follow_the_order_of_the_bayer_pattern(order):
    raw = np.zeros((32, 48), dtype=np.uint16)
    for place, colour in enumerate(order):
        raw[place // 2 :: 2, place % 2 :: 2] = {"R": 300, "G": 200, "B": 100}[colour]
    colours = developed(raw, 12, 0, order)[4:-4, 4:-4]
    assert_array_equal(colours.reshape(-1, 3)[0], [300 * 16, 200 * 16, 100 * 16])
    assert (colours == colours[0, 0]).all()


@pytest.mark.parametrize("pi5", [False, True])
@pytest.mark.parametrize("name", list(SENSORS))
def test_every_camera_module_gives_dark_and_lit_frames_of_its_format(world, monkeypatch, name, pi5):
    monkeypatch.setattr(FakePicamera2, "model", name)
    monkeypatch.setattr(FakePicamera2, "pi5", pi5)
    sensor = SENSORS[name]
    for raw in (False, True):
        with camera_in(
            world, PiCameraSettings(camera=name, image_size=(64, 96), raw=raw)
        ) as camera:
            camera.lock(0.02, 1.0)
            asked = FakePicamera2.opened[-1].configuration
            assert asked["raw"]["size"] == sensor.size[::-1]
            dark = camera.capture()
            assert dark.pixels.shape == (64, 96, 1 if sensor.mono else 3)
            assert dark.pixels.dtype == (np.uint16 if raw else np.uint8)
            world.switch(3, True)
            lit = camera.capture()
            world.switch(3, False)
            assert lit.pixels[..., 0].mean() > dark.pixels[..., 0].mean() + 0.5
            # no light is where the sensor has it, on the scale of 16 bits, whichever Pi it is
            if raw:
                assert dark.black_level == sensor.black * 2 ** (16 - sensor.bits)
                assert dark.pixels.min() >= dark.black_level
                assert dark.pixels.mean() - dark.black_level < 10 * 2.13 * 2 ** (16 - sensor.bits)
        with bad_input("gain is 1 to"):
            camera.lock(0.02, sensor.max_gain + 1)


def test_image_sizes_of_every_module_fit_its_sensor():
    for name, sensor in SENSORS.items():
        settings = PiCameraSettings(camera=name)
        assert settings.image_size is None
        # even, a multiple of 32, on the sensor
        PiCameraSettings(camera=name, image_size=sensor.image_size)
        with bad_input(r"pi\.image_size must be even rows up to"):
            PiCameraSettings(camera=name, image_size=(sensor.size[0] + 2, 32))
    with bad_input(r"pi\.camera must be"):
        PiCameraSettings(camera="imx500")


def test_the_documentation_lists_the_modules():
    page = (Path(__file__).resolve().parents[4] / "docs" / "guide" / "capture.md").read_text(
        encoding="utf-8"
    )
    table = (
        page.partition("<!-- cameras -->")[2]
        .partition("<!-- /cameras -->")[0]
        .strip()
        .splitlines()[2:]
    )
    assert table == [
        f"| `{name}` | {s.module} | {s.image_size[0]} x {s.image_size[1]} | {s.pixel_um:g} |"
        f" {'global' if s.global_shutter else 'rolling'} |"
        for name, s in SENSORS.items()
    ]


def test_another_module_than_stated_is_refused(world):
    with bad_input(r"the camera is a imx219, not the imx708 .*set pi\.camera"):
        camera_in(world, PiCameraSettings(camera="imx708"))


def test_a_raw_format_that_cannot_be_read_is_refused(world, monkeypatch):
    with camera_in(world, PiCameraSettings(image_size=(64, 96), raw=True)) as camera:
        fake = FakePicamera2.opened[-1]
        monkeypatch.setattr(
            fake, "camera_configuration", lambda: {"raw": {"format": "BGGR_PISP_COMP1"}}
        )
        with bad_input("as BGGR_PISP_COMP1, which cannot be read"):
            camera.capture()


def test_without_a_camera_the_pi_is_refused_and_dark(world, pins, monkeypatch):  # noqa: F811
    monkeypatch.setattr(FakePicamera2, "cameras", 0)
    for pin in PINS:
        pins.pin(pin).function = "output"
        pins.pin(pin).state = True
    with bad_input("no camera was found"), opened_pi(default_rig(), SMALL):
        pass
    assert not any(pins.pin(pin).function == "output" and pins.pin(pin).state for pin in PINS)


def opened(rig=None):
    with opened_pi(rig or default_rig(), SMALL):
        pass


def test_a_camera_in_use_is_refused(world, pins, monkeypatch):  # noqa: F811
    monkeypatch.setattr(FakePicamera2, "broken", True)
    with bad_input(r"could not be started .*resource busy.*close other programs"):
        opened()


def test_missing_libraries_are_named(pins, monkeypatch):  # noqa: F811
    monkeypatch.setitem(sys.modules, "picamera2", None)
    with bad_input(r"picamera2.*apt install"):
        opened()
    monkeypatch.setitem(sys.modules, "gpiozero", None)
    with bad_input(r"gpiozero.*apt install"):
        opened()


@pytest.mark.parametrize(
    "error",
    [
        "ValueError('numpy.dtype size changed, may indicate binary incompatibility')",
        "ImportError('numpy.core.multiarray failed to import')",
    ],
)
def test_picamera2_for_numpy_1_is_refused(pins, monkeypatch, tmp_path, error):  # noqa: F811
    (tmp_path / "picamera2.py").write_text(f"raise {error}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "picamera2", raising=False)
    with bad_input(r"compiled for numpy 1 .* numpy 2.*Trixie"):
        opened()


def test_a_computer_without_gpio_lines_is_refused(monkeypatch):
    monkeypatch.setattr(gpiozero.Device, "pin_factory", None)

    def none():
        # an error in tests
        warnings.warn(gpiozero.PinFactoryFallback("Falling back from lgpio"), stacklevel=1)
        raise gpiozero.BadPinFactory("Unable to load any default pin factory!")

    monkeypatch.setattr(gpiozero.Device, "_default_pin_factory", none)
    with bad_input(r"no GPIO lines.*`device` twin"):
        opened()


def test_a_line_in_use_is_named_and_the_others_are_released(world, pins):  # noqa: F811
    taken = gpiozero.LED(PINS[5])
    with bad_input(f"GPIO{PINS[5]}.*in use"):
        opened()
    taken.close()
    opened()  # nothing was kept


@pytest.mark.hardware
def test_a_real_rig_gives_a_dark_and_a_lit_picture():
    with opened_pi(default_rig(), PiCameraSettings()) as devices:
        camera, lights = devices.camera, devices.lights
        camera.lock(0.02, 1.0)
        dark = camera.capture().pixels.mean()
        for led in range(lights.count):
            lights.on(led)
            assert camera.capture().pixels.mean() > dark
