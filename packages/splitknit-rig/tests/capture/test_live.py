"""Live frames: the newest is measured, late ones are dropped, sources end as they should; heights are right."""

from __future__ import annotations

import threading
import time
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from gel_frames import PITCH_MM, SIZE, cap, dots, frame, shading
from splitknit.errors import BadInput
from splitknit.io.images import write_image
from splitknit.photometric.shading import shading_slopes
from splitknit_rig.capture.live import FrameSource, HeightMeter, Live, linear_colours, open_frames

FLAT = np.zeros(SIZE)


def numbered(period_s: float = 0.005):
    """Frames that hold their number."""
    return (np.full((4, 6, 3), k % 256, np.uint8) for k in range(1, 10_000)), period_s


def source(frames, period_s: float = 0.0, closed=None) -> FrameSource:
    return FrameSource("test", frames, "linear", period_s, (closed or threading.Event()).set)


def test_late_frames_are_dropped_and_the_camera_is_given_back() -> None:
    frames, period_s = numbered()
    closed = threading.Event()

    def slow(pixels):
        time.sleep(0.06)
        return int(pixels[0, 0, 0])

    with Live(source(frames, period_s, closed), slow) as live:
        first = live.newest(0, 5.0)
        second = live.newest(first.number, 5.0)
        assert second.measured == second.number > first.number + 1
        assert second.dropped == second.number - first.number - 1
        assert live.newest(second.number + 1000, 0.01) is None
        assert not closed.is_set()
    assert closed.is_set() and threading.active_count() == len(threading.enumerate())
    assert not any(thread.is_alive() for thread in live._threads)


def test_held_it_measures_nothing_more_until_it_goes_on() -> None:
    with Live(source(*numbered()), lambda pixels: None) as live:
        live.hold(True)
        time.sleep(0.05)
        held = live.newest(0, 5.0)
        if held is not None:
            assert live.newest(held.number, 0.1) is None
        live.hold(False)
        assert live.newest(0 if held is None else held.number, 5.0) is not None


def test_a_camera_that_fails_is_reported_to_who_asks() -> None:
    def frames():
        yield np.zeros((4, 6, 3), np.uint8)
        raise BadInput("the UVC camera gave no picture")

    with (
        Live(source(frames()), lambda pixels: None) as live,
        pytest.raises(BadInput, match="test: the UVC camera gave"),
    ):
        live.newest(10, 5.0)


def test_a_folder_is_played_over_and_over_and_grey_is_three_colours(tmp_path: Path) -> None:
    write_image(tmp_path / "b.png", np.full((4, 6, 3), 9, np.uint8))
    write_image(tmp_path / "a.png", np.full((4, 6), 5, np.uint8))
    (tmp_path / "note.txt").write_text("no frame")
    opened = open_frames(str(tmp_path), "srgb")
    assert [int(next(opened.frames)[0, 0, 2]) for _ in range(5)] == [5, 9, 5, 9, 5]
    assert (opened.name, opened.encoding, opened.period_s) == (tmp_path.name, "srgb", 0.1)


def test_a_film_is_played_over_and_over(tmp_path: Path) -> None:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for level in (40, 200):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    opened = open_frames(str(path))
    seen = [int(next(opened.frames).mean()) > 100 for _ in range(5)]
    opened.close()
    assert seen == [False, True, False, True, False]
    assert opened.period_s == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("made", "words"),
    [("", "neither a camera's number"), ("folder", "holds no photographs"), ("text", "not a film that can be read")],
)
def test_what_is_no_source_is_refused(tmp_path: Path, made: str, words: str) -> None:
    path = tmp_path / "it"
    if made == "folder":
        path.mkdir()
    if made == "text":
        path.write_text("no film")
    with pytest.raises(BadInput, match=words):
        open_frames(str(path))


@pytest.mark.skipif(Path("/dev/video63").exists(), reason="there is such a camera")
def test_a_camera_that_is_not_there_is_one_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BadInput, match="no UVC camera 63 was found"):
        open_frames("63")
    assert capfd.readouterr().err == ""  # OpenCV's own complaints would stand beside it


def test_linear_light_of_8_and_16_bits() -> None:
    eight = np.array([[[0, 128, 255]]], np.uint8)
    assert linear_colours(eight, "linear")[:, 0, 0].tolist() == pytest.approx([0, 128 / 255, 1])
    assert linear_colours(eight.astype(np.uint16) * 257, "srgb")[1, 0, 0] == pytest.approx(0.2159, abs=1e-3)


def meter(marker_px: float = 0.0) -> HeightMeter:
    return HeightMeter(partial(shading_slopes, shading()), PITCH_MM, SIZE, marker_px=marker_px)


HEIGHT = cv2.GaussianBlur(cap(85, 62, 45, 27), (0, 0), 1.5)


def error_um(measured, height) -> float:
    """Rms of the difference without its mean."""
    return float((measured - 1000 * PITCH_MM * height).std())


def test_a_ball_is_measured_in_micrometres_whatever_the_light_over_the_field() -> None:
    measure = meter()
    assert np.abs(measure(frame(FLAT)).height_um).max() < 15  # noise, and a frame of its own is the flat one
    found = measure(frame(HEIGHT))
    assert error_um(found.height_um, HEIGHT) < 15  # of a cap of 1.1 mm
    edge = np.concatenate([found.height_um[:3].ravel(), found.height_um[-3:].ravel()])
    assert abs(float(np.median(edge))) < 5
    assert not found.markers.any() and "markers cover" not in found.facts()["facts"]


def test_markers_that_moved_are_bridged() -> None:
    """The dots of the pressed gel lie elsewhere than those of the flat one, as a gel's do."""
    errors = {}
    for marker_px in (0.0, 6.0):
        measure = meter(marker_px)
        measure.take_flat(frame(FLAT, dots(24, 6, 8)))
        found = measure(frame(HEIGHT, dots(24, 6, 11)))
        errors[marker_px] = error_um(found.height_um, HEIGHT)
    assert errors[6.0] < 25 and errors[6.0] < 0.5 * errors[0.0]
    assert 0.05 < float(found.markers.mean()) < 0.2


def test_larger_frames_of_the_same_sides_are_scaled_and_others_refused() -> None:
    measure = meter()
    measure.take_flat(cv2.resize(frame(FLAT), None, fx=2, fy=2))
    assert measure(cv2.resize(frame(HEIGHT), None, fx=2, fy=2)).height_um.shape == SIZE
    with pytest.raises(BadInput, match="calibration is of 160 x 120 pixels, but frames have 100 x 100"):
        measure(np.zeros((100, 100, 3), np.uint8))
    with pytest.raises(BadInput, match="switch the light on"):
        measure.take_flat(np.zeros((*SIZE, 3), np.uint8))
