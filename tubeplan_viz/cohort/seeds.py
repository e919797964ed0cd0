"""A seed of its own for each case of a cohort, from one for all."""

from __future__ import annotations

import hashlib

import numpy as np


def case_seed(entropy: int, case_id: str) -> int:
    """The seed of one case.

    It is drawn from the child of ``SeedSequence(entropy)`` that the digest of the id names, so that neither the order
    of the cases nor how many there are changes it.

    Parameters
    ----------
    entropy : int
        Seed of the cohort, 0 or more.
    case_id : str

    Returns
    -------
    int
        0 to 2**32 - 1.

    Examples
    --------
    >>> case_seed(1, "a") == case_seed(1, "a"), case_seed(1, "a") == case_seed(1, "b"), case_seed(2, "a") == case_seed(1, "a")
    (True, False, False)
    """
    name = np.frombuffer(hashlib.sha256(case_id.encode("utf-8")).digest(), dtype="<u4")
    child = np.random.SeedSequence(entropy, spawn_key=tuple(int(word) for word in name))
    return int(child.generate_state(1)[0])
