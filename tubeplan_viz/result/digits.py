"""How many decimals tell two numbers apart."""

from __future__ import annotations


def digits_apart(value: float, limit: float, digits: int) -> int:
    """Decimals, at least `digits` and at most 6, at which `value` and `limit` no longer print alike; `digits` where none do.

    Examples
    --------
    >>> digits_apart(1.047, 1.05, 2), digits_apart(1.05 + 1e-9, 1.05, 2), digits_apart(-0.003, 0.0, 2)
    (3, 2, 3)
    """
    return next((n for n in range(digits, 7) if f"{value:z.{n}f}" != f"{limit:z.{n}f}"), digits)
