"""What the trainings of `metric`'s two networks have in common: size, patches, learning rate, machine."""

from __future__ import annotations

import math
from dataclasses import dataclass

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class FieldsSettings:
    """Training of a network that turns fields on a grid into others."""

    widths: tuple[int, ...] = (16, 32, 48, 64, 64)
    """Channels of each level; every level but the first works at half the scale of the one before."""
    iterations: int = 7200
    """Corrections of the weights."""
    batch: int = 6
    """Patches of each."""
    patch_px: int = 192
    """Side of a patch; a multiple of the network's stride."""
    least_trust: float = 0.2
    """Patches whose mean weight is less are not used: they hold next to no skin."""
    learning_rate: float = 1.5e-3
    """The highest."""
    warm_up: int = 200
    """Iterations over which the learning rate rises; then it falls along a cosine."""
    last_rate: float = 0.02
    """Learning rate at the end, relative to `learning_rate`."""
    gradient_limit: float = 5.0
    """Longest gradient; longer ones are shortened."""
    report_every: int = 200
    """Iterations between two entries of the learning curve, after each of which a training can be taken up again."""
    seed: int = 0
    """Of weights and patches."""
    device: str = "cpu"
    """``cpu`` or ``cuda``."""
    threads: int = 1
    """Of torch on the processor; a training is repeatable for a fixed number."""
    precision: str = "mixed"
    """``mixed`` (bfloat16 products, float32 weights and sums) or ``float32``."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "widths", tuple(self.widths))
        require(
            2 <= len(self.widths) <= 7 and min(self.widths) >= 1,
            f"training: widths must be two to seven positive numbers, but they are {list(self.widths)}.",
        )
        for name, low, high in (
            ("iterations", 1, 10_000_000),
            ("batch", 1, 4096),
            ("patch_px", 1, 2048),
            ("warm_up", 1, 10_000_000),
            ("report_every", 1, 10_000_000),
            ("threads", 1, 1024),
        ):
            value = getattr(self, name)
            require(low <= value <= high, f"training: {name} must lie between {low} and {high}, but it is {value}.")
        require(
            self.patch_px % self.stride == 0,
            f"training: patch_px must be a multiple of {self.stride}, but it is {self.patch_px}.",
        )
        self._check_shares("least_trust")
        for name in ("learning_rate", "gradient_limit"):
            value = getattr(self, name)
            require(math.isfinite(value) and value > 0, f"training: {name} must be positive.")
        self._check_weights("last_rate")
        require(self.seed >= 0, "training: seed must not be negative.")
        require(self.device in ("cpu", "cuda"), f"training: device must be cpu or cuda, not '{self.device}'.")
        require(
            self.precision in ("mixed", "float32"),
            f"training: precision must be mixed or float32, not '{self.precision}'.",
        )

    def _check_shares(self, *names: str) -> None:
        for name in names:
            require(0 <= getattr(self, name) < 1, f"training: {name} must lie in [0, 1).")

    def _check_weights(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            require(math.isfinite(value) and value >= 0, f"training: {name} must not be negative.")

    @property
    def depth(self) -> int:
        """How many times the network halves the scale."""
        return len(self.widths) - 1

    @property
    def stride(self) -> int:
        """Both sides of what the network sees are multiples of this."""
        return int(2**self.depth)

    def rate(self, iteration: int) -> float:
        """Learning rate of an iteration, counted from zero."""
        rise = min(1.0, (iteration + 1) / self.warm_up)
        fall = 0.5 * (1.0 + math.cos(math.pi * min(iteration / self.iterations, 1.0)))
        return self.learning_rate * rise * (fall * (1.0 - self.last_rate) + self.last_rate)
