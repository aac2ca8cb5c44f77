"""Random numbers that depend on the seed alone (splitmix64, compiled)."""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import kernel


@kernel()
@no_type_check
def random_bits(state):
    """Next 64 random bits (splitmix64); `state` is one uint64, changed."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel()
@no_type_check
def uniform(state):
    """Random number in [0, 1)."""
    return np.float64(random_bits(state) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@kernel()
@no_type_check
def below(state, count):
    """Random integer from 0 to count - 1."""
    return np.int64(uniform(state) * count)
