"""Read-only arrays: what crosses a boundary cannot be changed behind its owner's back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
VoxelArray = NDArray[np.int16]


def frozen_array(
    values: ArrayLike,
    shape: tuple[int | None, ...],
    name: str,
    *,
    dtype: Any = np.float64,
) -> NDArray[Any]:
    """A read-only array of the given shape; ``None`` in `shape` leaves that axis free.

    An array that is already read-only and of the right type is passed through, so
    that a CT is held once.

    Raises
    ------
    ValueError
        If the shape differs, or a floating-point value is not finite.
    """
    array = np.asarray(values, dtype=dtype)
    if array.ndim != len(shape) or any(want is not None and want != have for want, have in zip(shape, array.shape, strict=True)):
        wanted = tuple("n" if n is None else n for n in shape)
        raise ValueError(f"{name} has shape {array.shape}, expected {wanted}")
    if np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
        raise ValueError(f"{name} holds values that are not finite")
    if array.flags.writeable:
        if array is values or np.shares_memory(array, np.asarray(values)):
            array = array.copy() if array.nbytes < 1 << 24 else array.view()
        array.flags.writeable = False
    return array
