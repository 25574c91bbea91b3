"""Which finger of a photograph is meant: what `match`, `print` and `enroll` ask."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from splitknit import BadInput
from splitknit.arguments import AnyPath
from splitknit.errors import require
from splitknit.model import BoolArray


@dataclass(frozen=True, slots=True)
class PhotoFinger:
    """Which finger is meant; by default the clearest."""

    mask: AnyPath | None = None
    box: str | None = None

    @property
    def chosen(self) -> bool:
        """Whether somebody chose."""
        return self.mask is not None or self.box is not None

    def pixels(self, size: tuple[int, ...]) -> BoolArray | None:
        """(H, W) bool of the mask of a photograph of `size`. Raises BadInput if it has another."""
        if self.mask is None:
            return None
        from splitknit.io.photos import read_photo  # a template needs none of it

        def check(rows: int, columns: int) -> None:
            require(
                (rows, columns) == size,
                f"{self.mask} has {rows} x {columns} pixels (rows x columns), but the photograph"
                f" has {size[0]} x {size[1]}.",
            )

        white = read_photo(self.mask, check).pixels.mean(axis=-1)
        return np.asarray(white > 0.5 * max(float(white.max()), 1.0))

    def corners(self) -> tuple[int, int, int, int] | None:
        """The box as numbers. Raises BadInput if it is not four of them, or there is a mask too."""
        if self.box is None:
            return None
        require(self.mask is None, "give `mask` or `box`, not both.")
        numbers = re.fullmatch(
            r"(\d{1,6}),(\d{1,6}),(\d{1,6}),(\d{1,6})", self.box.replace(" ", "")
        )
        if numbers is None:
            raise BadInput(
                "`box` must be four whole numbers X,Y,W,H, such as 400,300,800,1200, not"
                f" '{self.box}'."
            )
        x, y, w, h = map(int, numbers.groups())
        return x, y, w, h
