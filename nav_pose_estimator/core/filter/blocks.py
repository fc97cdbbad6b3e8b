"""Optional blocks of the error state: their table, their place in the filter's arrays, and their process models.

A filter has the base states of ``filter.layout`` and any subset of ``BLOCKS``, one after the other in the order of this
table. Only the constants vector says which blocks a filter has and where each begins (``I_WIND`` ..., -1 without); the
size of an array never does. Each block has an estimate in ``nav``. Its error state, truth minus estimate, is a
Gauss-Markov process or a random walk.

| block | states | enters |
|---|---|---|
| wind | velocity of the air, East, North [m/s] | observations of the velocity through the air |
| gyro_matrix | M (3, 3) row-major in w_measured = (I + M) w + bias | attitude: phi_dot = ... - C M w |
| dvl | biases of four beams [m/s], common scale error k, rotation vector m (3) [rad] of the mounting: measured =\
 (1 + k) (Exp(m) direction) . velocity + bias | observations of beams |
| depth | bias of a height from water pressure [m] | observations of that height |
| gravity | gravity disturbance in n [m/s^2] | velocity: dv_dot = ... - dg |
| airspeed | scale error k of an airspeed sensor: measured = (1 + k) airspeed | observations of the airspeed |
| gnss_error | time-correlated GNSS errors in n: positions (3) [m], velocities (3) [m/s]; measured = true + error |\
 observations of GNSS |
| dvl_delay | delay d [s]: the velocity in the row of dvl is velocity - d (dv/dt) | observations of beams |

Sources: CN114459477B (dvl, there without the mounting, depth: states 16 to 21); J. Sola (2017), section 5.3 (gravity,
there with the other sign); A. Bryson and D. Johansen, IEEE Trans. Automatic Control 10(1), 1965 (gnss_error: coloured
measurement noise as states).
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.jit import inlined, kernel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Block:
    """One block: ``size`` states, estimates at ``nav`` in the nominal state, first state in constant ``index``."""

    name: str
    size: int
    nav: int
    index: int

    def is_in(self, constants: Array) -> bool:
        """Whether the filter of ``constants`` has the block."""
        return bool(constants[self.index] >= 0.0)

    def states(self, constants: Array) -> slice:
        """The block's states in the error state of a filter that has it."""
        start = int(constants[self.index])
        return slice(start, start + self.size)

    @property
    def estimates(self) -> slice:
        """The block's estimates in ``nav``."""
        return slice(self.nav, self.nav + self.size)

    @property
    def psd(self) -> slice:
        """Densities of the block's driving noise in the constants."""
        start = at.BLOCK_PSD + self.nav - at.WIND
        return slice(start, start + self.size)

    @property
    def rate(self) -> slice:
        """The block's rates 1/tau in the constants."""
        start = at.BLOCK_RATE + self.nav - at.WIND
        return slice(start, start + self.size)


WIND = Block("wind", 2, at.WIND, at.I_WIND)
GYRO_MATRIX = Block("gyro_matrix", 9, at.GYRO_MATRIX, at.I_GYRO_MATRIX)
DVL = Block("dvl", 8, at.DVL, at.I_DVL)
DEPTH = Block("depth", 1, at.DEPTH, at.I_DEPTH)
GRAVITY = Block("gravity", 3, at.GRAVITY, at.I_GRAVITY)
AIRSPEED = Block("airspeed", 1, at.AIRSPEED, at.I_AIRSPEED)
GNSS_ERROR = Block("gnss_error", 6, at.GNSS_ERROR, at.I_GNSS_ERROR)
DVL_DELAY = Block("dvl_delay", 1, at.DVL_DELAY, at.I_DVL_DELAY)
BLOCKS = (WIND, GYRO_MATRIX, DVL, DEPTH, GRAVITY, AIRSPEED, GNSS_ERROR, DVL_DELAY)
"""All blocks, in their order in the error state and in ``nav``."""
TABLE = tuple((block.index, block.size, block.nav) for block in BLOCKS)
"""(constant with the first state, size, place in ``nav``) of every block, for kernels."""


@dataclass(frozen=True, slots=True)
class GaussMarkov:
    """Process model of a block: random walk per root second and correlation time [s], for all states or one each."""

    walk: float | tuple[float, ...] = 0.0
    tau: float | tuple[float, ...] = math.inf


# --- which blocks a filter has --------------------------------------------------------------------------------------
def set_blocks(constants: Array, blocks: Collection[Block]) -> None:
    """Set the blocks of the filter of ``constants`` to exactly these."""
    start = at.BASE_STATES
    for block in BLOCKS:
        constants[block.index] = start if block in blocks else -1.0
        start += block.size * (block in blocks)


def blocks_of(constants: Array) -> tuple[Block, ...]:
    """The blocks of the filter of ``constants``, in order."""
    return tuple(block for block in BLOCKS if constants[block.index] >= 0.0)


def set_process(constants: Array, block: Block, process: GaussMarkov) -> None:
    """Set the process model of ``block`` in the filter of ``constants``."""
    constants[block.psd] = np.square(process.walk)
    constants[block.rate] = np.divide(1.0, process.tau)


def keep_blocks(constants: Array, before: Array) -> None:
    """Add the blocks of the filter ``before`` to that of ``constants``, with their process models."""
    own = blocks_of(constants)
    set_blocks(constants, {*own, *blocks_of(before)})
    for block in blocks_of(before):
        if block not in own:
            constants[block.psd], constants[block.rate] = before[block.psd], before[block.rate]


@kernel
def state_count(constants):
    """Size n of the error state."""
    n = at.BASE_STATES
    for index, size, _ in TABLE:
        if constants[index] >= 0.0:
            n += size
    return n


@kernel
def states_within(constants, wider):
    """Index of each state of the filter of ``constants`` in that of ``wider``, which has all its blocks and others."""
    places = np.arange(state_count(constants))
    for index, size, _ in TABLE:
        if constants[index] >= 0.0:
            for i in range(size):
                places[int(constants[index]) + i] = int(wider[index]) + i
    return places


# --- covariances ----------------------------------------------------------------------------------------------------
def with_block(constants: Array, P: Array, block: Block, cov: ArrayLike) -> tuple[Array, Array]:
    """(constants, P) of the filter with one more block of covariance ``cov``, uncorrelated with all other states."""
    wider = constants.copy()
    set_blocks(wider, (*blocks_of(constants), block))
    return wider, enlarged(P, constants, wider, {block: cov})


def enlarged(P: Array, constants: Array, wider: Array, cov: Mapping[Block, ArrayLike]) -> Array:
    """``P`` of the filter of ``constants``, enlarged to the states of ``wider``; ``cov`` has that of each new block.

    A covariance is (size, size), or one number for the variance of all states of the block. New blocks are uncorrelated
    with all other states.
    """
    n = state_count(wider)
    larger = np.zeros((n, n))
    kept = states_within(constants, wider)
    larger[np.ix_(kept, kept)] = P
    for block in blocks_of(wider):
        if constants[block.index] < 0.0:
            own = block.states(wider)
            larger[own, own] = np.multiply(cov[block], np.eye(block.size)) if np.ndim(cov[block]) == 0 else cov[block]
    return larger


# --- for kernels ----------------------------------------------------------------------------------------------------
@inlined
def add_rates(F, constants):
    """Write the decay rates of all optional states to the system matrix ``F``."""
    for index, size, nav in TABLE:
        start = int(constants[index])
        if start >= 0:
            for i in range(size):
                F[start + i, start + i] = -constants[at.BLOCK_RATE + nav - at.WIND + i]


@inlined
def add_block_noise(P, constants, T):
    """Add the driving noise of all optional states over ``T`` [s] to the covariance ``P``."""
    for index, size, nav in TABLE:
        start = int(constants[index])
        if start >= 0:
            for i in range(size):
                P[start + i, start + i] += constants[at.BLOCK_PSD + nav - at.WIND + i] * T


@inlined
def fade_gnss_error(nav, constants, T):
    """Decay of the estimated GNSS errors over ``T`` [s]; unlike biases they are not held between updates."""
    if constants[at.I_GNSS_ERROR] >= 0.0:
        for i in range(6):
            rate = constants[at.BLOCK_RATE + at.GNSS_ERROR - at.WIND + i]
            nav[at.GNSS_ERROR + i] *= math.exp(-rate * T)
