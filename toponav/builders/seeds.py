"""`seed_of`: seeds that differ from each other."""

import numpy as np


def seed_of(*parts: int) -> int:
    """A seed that differs, as good as surely, if any of the numbers does.

    Examples:
        >>> seed_of(0, 1) == seed_of(1, 0)
        False
    """
    return int(np.random.SeedSequence(parts).generate_state(1)[0] >> 1)
