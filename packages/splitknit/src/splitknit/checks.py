"""Checks of arrays: type, shape and range, or :class:`splitknit.errors.BadInput`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from splitknit.errors import require

if TYPE_CHECKING:  # numpy takes longer to import than all the rest of `splitknit --help`
    import numpy as np
    from numpy.typing import NDArray


def check_stack(stack: Any, *, least: int = 1, name: str = "stack") -> NDArray[np.float32]:
    """Return `stack` as a finite float32 array of shape (L, H, W) with at least `least` images."""
    import numpy as np

    array = np.asarray(stack)
    require(
        array.ndim == 3,
        f"{name} must have the shape (L, H, W), but it has the shape {array.shape}.",
    )
    require(
        array.shape[0] >= least,
        f"{name} must hold at least {least} images, but it holds {array.shape[0]}.",
    )
    require(
        array.shape[1] > 0 and array.shape[2] > 0, f"{name} has empty images: shape {array.shape}."
    )
    return _finite(array, name)


def check_image(image: Any, *, name: str = "image") -> NDArray[np.float32]:
    """Return `image` as a finite float32 array of shape (H, W)."""
    import numpy as np

    array = np.asarray(image)
    require(
        array.ndim == 2 and array.size > 0,
        f"{name} must have the shape (H, W), but it has {array.shape}.",
    )
    return _finite(array, name)


def check_mask(mask: Any, shape: tuple[int, int], *, name: str = "mask") -> NDArray[np.bool_]:
    """Return `mask` as a boolean array of `shape` that is true somewhere; ``None`` gives an
    all-true mask."""
    import numpy as np

    if mask is None:
        return np.ones(shape, dtype=np.bool_)
    array = np.asarray(mask)
    require(array.shape == shape, f"{name} must have the shape {shape}, but it has {array.shape}.")
    result = array.astype(np.bool_, copy=False)
    require(result.any(), f"{name} is empty: not one pixel belongs to the surface.")
    return result


def check_lights(
    lights: Any, count: int | None = None, *, name: str = "lights"
) -> NDArray[np.float64]:
    """`lights` as a float64 array (L, 3) that determines a normal: finite, non-zero, distinct, not
    coplanar. A row's length is the light's relative strength. Directions within 0.5 deg are
    duplicates; where the smallest singular value is below 1 % of the largest they lie in one plane
    for all practical purposes. Raises BadInput otherwise.
    """
    import numpy as np

    array = np.asarray(lights, dtype=np.float64)
    require(
        array.ndim == 2 and array.shape[1] == 3,
        f"{name} must have the shape (L, 3), but it has {array.shape}.",
    )
    finite = np.isfinite(array) & (np.abs(array) < 1e100)  # the squares of more overflow
    require(finite.all(), f"{name} contains NaN or infinite values.")
    require(
        count in (None, array.shape[0]),
        f"{name} and images differ in number: {array.shape[0]} lights for {count} images.",
    )
    require(
        array.shape[0] >= 3,
        f"photometric stereo needs at least 3 lights, but {name} holds {array.shape[0]}.",
    )
    norms = np.linalg.norm(array, axis=1)
    require((norms > 0).all(), f"{name} contains a zero vector (light {int(np.argmin(norms))}).")
    unit = array / norms[:, None]
    cosines = unit @ unit.T - 2.0 * np.eye(len(unit))
    i, j = np.unravel_index(int(np.argmax(cosines)), cosines.shape)
    require(
        cosines[i, j] < np.cos(np.deg2rad(0.5)),
        f"{name} {min(i, j)} and {max(i, j)} have the same direction; remove one or correct the"
        " rig.",
    )
    singular = np.linalg.svd(unit, compute_uv=False)
    require(
        singular[-1] > 0.01 * singular[0],
        f"{name} are coplanar; normals need light directions that span three dimensions.",
    )
    return array


def _finite(array: NDArray[Any], name: str) -> NDArray[np.float32]:
    import numpy as np

    result = np.ascontiguousarray(array, dtype=np.float32)
    require(np.isfinite(result).all(), f"{name} contains NaN or infinite values.")
    return result
