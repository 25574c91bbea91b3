"""What every camera and every bank of LEDs must do. Each implementation inherits these tests and
makes the devices."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from abc import ABC, abstractmethod

import numpy as np
import pytest

from refusals import bad_input
from splitknit.devices import CameraDevice, LightBank, relative_exposure
from splitknit.errors import BadInput


class LightContract(ABC):
    """For one implementation of :class:`splitknit.devices.LightBank`."""

    making: str
    """Python that makes `bank`, and `burning()` which tells what the hardware really does; for a
    process of its own."""

    @abstractmethod
    def bank(self) -> LightBank:
        """Return a new bank whose LEDs were lit before, as far as the hardware allows that."""

    @abstractmethod
    def burning(self) -> set[int]:
        """LEDs that the hardware lights, whatever the bank believes."""

    @abstractmethod
    def most_at_once(self) -> int:
        """Largest number of LEDs that ever burnt together since the bank was made."""

    @abstractmethod
    def now_s(self) -> float:
        """Time on the clock on which LEDs settle."""

    def test_all_leds_are_off_after_construction(self):
        with self.bank() as bank:
            assert self.burning() == set()
            assert bank.lit == frozenset()
            assert bank.count == 14

    def test_one_led_is_lit_at_a_time(self):
        with self.bank() as bank:
            for led in (0, 13, 5, 5, 6):
                bank.on(led)
                assert self.burning() == {led}
                assert bank.lit == {led}
            assert self.most_at_once() == 1
            bank.off()
            assert self.burning() == set()

    def test_several_leds_are_lit_only_by_on_together(self):
        with self.bank() as bank:
            bank.on_together((2, 7, 9))
            assert self.burning() == {2, 7, 9}
            bank.on(7)
            assert self.burning() == {7}

    def test_an_led_has_settled_when_the_call_returns(self):
        with self.bank() as bank:
            assert bank.settle_s > 0
            for led in (3, 4):
                before = self.now_s()
                bank.on(led)
                assert self.now_s() - before >= bank.settle_s * (1 - 1e-9)
            before = self.now_s()
            bank.off()
            # the light fades before the dark frame
            assert self.now_s() - before >= bank.settle_s * (1 - 1e-9)

    @pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit, BadInput])
    def test_leds_are_off_after_an_exception(self, error):
        with pytest.raises(error), self.bank() as bank:
            bank.on_together((1, 2))
            raise error
        assert self.burning() == set()

    def test_leds_are_off_after_an_interrupt_while_one_settles(self, monkeypatch):
        def interrupted(seconds):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt), self.bank() as bank:
            monkeypatch.setattr(bank, "_wait", interrupted)
            bank.on(4)
        assert self.burning() == set()

    def test_one_shines_for_a_time(self):
        with self.bank() as bank:
            before = self.now_s()
            bank.shine(4, 0.3)
            assert self.now_s() - before >= 0.3
            assert self.burning() == set()
            assert self.most_at_once() == 1

    @pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
    def test_off_after_an_interrupt_while_one_shines(self, monkeypatch, error):
        with self.bank() as bank:
            wait = bank._wait

            def interrupted(seconds):
                if seconds > 1:
                    assert self.burning() == {4}
                    raise error
                wait(seconds)

            monkeypatch.setattr(bank, "_wait", interrupted)
            with pytest.raises(error):
                bank.shine(4, 5.0)
            assert self.burning() == set()  # before the bank is closed

    def test_the_other_leds_go_off_although_one_switch_fails(self, monkeypatch):
        with self.bank() as bank:
            bank.on_together((1, 2, 3))
            switch = bank._switch
            failing = [True]

            def broken(led, lit):
                if led == 2 and failing[0]:
                    raise OSError("no such line")
                switch(led, lit)

            monkeypatch.setattr(bank, "_switch", broken)
            with pytest.raises(OSError, match="no such line"):
                bank.off()
            assert self.burning() == {2}
            assert bank.lit == {2}
            failing[0] = False
        assert self.burning() == set()

    @pytest.mark.parametrize("led", [-1, 14, 99])
    def test_an_unknown_led_is_refused_and_nothing_changes(self, led):
        with self.bank() as bank:
            bank.on(6)
            with bad_input(f"no LED {led}.*0 to 13"):
                bank.on(led)
            with bad_input("no LED"):
                bank.on_together((3, led))
            with bad_input("at least one"):
                bank.on_together(())
            assert self.burning() == {6}

    def test_a_bank_may_be_closed_twice_and_stays_dark(self):
        bank = self.bank()
        bank.on(8)
        bank.close()
        bank.close()
        bank.off()
        assert self.burning() == set()
        with bad_input("closed"):
            bank.on(0)
        assert self.burning() == set()

    def test_leds_are_off_when_the_process_ends(self, tmp_path):
        """The bank is neither closed nor in a with block; what ends the process must not leave an
        LED lit."""
        ends = {
            "sys.exit(0)": 0,
            "raise RuntimeError('boom')": 1,
            "os.kill(os.getpid(), signal.SIGTERM); time.sleep(5)": -signal.SIGTERM,
            "os.kill(os.getpid(), signal.SIGHUP); time.sleep(5)": -signal.SIGHUP,
            "os.kill(os.getpid(), signal.SIGINT); time.sleep(5)": 1,
        }
        imports = [
            line for line in self.making.splitlines() if line.startswith(("from ", "import "))
        ]
        script = textwrap.dedent(f"""
            import os, signal, sys, time
            signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored without a terminal
            sys.path[:0] = {sys.path!r}
            {"; ".join(imports)}
            for number, end in enumerate({list(ends)}):  # forked after the slow imports
                if os.fork() == 0:
                    break
                print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
            else:
                sys.exit()
            {textwrap.indent(self.making, " " * 12).strip()}
            switch = bank._switch
            def traced(led, lit):
                switch(led, lit)
                with open(f"{tmp_path}/{{number}}", "a") as stream:
                    stream.write(repr(sorted(burning())) + "\\n")
            bank._switch = traced
            bank.on(3)
            try:
                exec(end)
            except KeyboardInterrupt:
                raise SystemExit(1)
        """)
        done = subprocess.run(
            [sys.executable, "-c", script], check=False, timeout=60, capture_output=True
        )
        assert [int(code) for code in done.stdout.split()] == list(ends.values()), (
            done.stderr.decode()
        )
        for number in range(len(ends)):
            states = (tmp_path / str(number)).read_text().split("\n")
            assert "[3]" in states
            assert states[-2] == "[]"


class CameraContract(ABC):
    """For one implementation of :class:`splitknit.devices.CameraDevice`."""

    readout_s = 0.0466

    @abstractmethod
    def devices(self) -> tuple[CameraDevice, LightBank]:
        """Return a camera and the LEDs that it sees."""

    @abstractmethod
    def now_s(self) -> float:
        """Time on the camera's clock."""

    def test_photographs_have_the_image_size_of_the_camera(self):
        camera, lights = self.devices()
        with lights, camera:
            frame, small = camera.capture(), camera.preview()
            assert frame.pixels.shape[:2] == camera.image_size
            assert frame.pixels.shape[2] in (1, 3)
            assert frame.pixels.dtype in (np.uint8, np.uint16)
            assert small.pixels.dtype == frame.pixels.dtype
            assert small.pixels.shape[0] <= frame.pixels.shape[0]
            aspect = frame.pixels.shape[1] / frame.pixels.shape[0]
            assert small.pixels.shape[1] / small.pixels.shape[0] == pytest.approx(aspect, rel=0.03)

    @pytest.mark.parametrize(
        ("exposure_s", "gain", "band"), [(0.008, 1.0, "white"), (0.06, 4.0, "nir")]
    )
    def test_frames_have_the_locked_exposure_and_gain(self, exposure_s, gain, band):
        camera, lights = self.devices()
        with lights, camera:
            camera.lock(exposure_s, gain, band)
            for frame in (camera.capture(), camera.preview(), camera.capture()):
                assert frame.exposure_s == pytest.approx(exposure_s, abs=4e-5)
                assert frame.gain == pytest.approx(gain, rel=0.02)
                assert relative_exposure(frame) == pytest.approx(exposure_s * gain, rel=0.03)

    def test_every_frame_was_exposed_wholly_after_the_call(self):
        camera, lights = self.devices()
        with lights, camera:
            before = 0.0
            for exposure_s in (0.01, 0.01, 0.1, 0.1, 0.002, 0.002):
                camera.lock(exposure_s, 1.0)
                called = self.now_s()
                frame = camera.capture()
                assert frame.at_s - self.readout_s - frame.exposure_s >= called - 1e-6
                assert frame.at_s <= self.now_s()
                assert frame.at_s > before
                before = frame.at_s

    def test_a_frame_shows_the_led_that_is_lit(self):
        camera, lights = self.devices()
        with lights, camera:
            camera.lock(0.01, 1.0)
            dark = camera.capture().pixels[..., 0].mean()
            lights.on(2)
            assert camera.capture().pixels[..., 0].mean() > dark + 1
            lights.off()
            assert camera.capture().pixels[..., 0].mean() == pytest.approx(dark, abs=0.3)

    @pytest.mark.parametrize(
        ("exposure_s", "gain", "band"),
        [
            (0.0, 1.0, "white"),
            (1e3, 1.0, "white"),
            (0.01, 0.1, "white"),
            (0.01, 1e3, "white"),
            (float("nan"), 1.0, "white"),
            (0.01, float("nan"), "white"),
            (0.01, 1.0, "ultraviolet"),
        ],
    )
    def test_an_exposure_out_of_range_is_refused(self, exposure_s, gain, band):
        camera, lights = self.devices()
        with lights, camera:
            camera.lock(0.02, 2.0)
            with bad_input():
                camera.lock(exposure_s, gain, band)
            assert camera.capture().exposure_s == pytest.approx(0.02, abs=4e-5)  # as before

    def test_a_camera_may_be_closed_twice_and_captures_no_more(self):
        camera, lights = self.devices()
        with lights:
            camera.close()
            camera.close()
            with bad_input("closed"):
                camera.capture()
