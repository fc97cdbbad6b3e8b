"""Turns of the magnetic field in b against those that the gyroscope measures.

A field that is constant in n turns in b as -w. So its directions, rotated back by the integrated rates into the axes of
one instant, coincide; their spread is 1 - |mean direction|^2, about the variance of the angle between them [rad^2].
Strength, inclination and declination of the field do not matter, nor does the vehicle's motion.

If the rates are G w, the spread is that of the hypothesis G^-1. A magnetometer whose axes are D, any permutation with
any signs, turns as (det D) D w does, which is a proper rotation of w for every D. So the 24 proper rotations can be
errors of either sensor, but a mirrored hypothesis (determinant -1), as one inverted axis, can only be an error of the
gyroscope.
"""

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import add, dot, load3, q_exp, q_multiply, q_rotate

_PART = 5  # consecutive bins whose angles are summed to one rotation vector


@kernel
def spreads(angles, fields, gyros):
    """Spread (H,) of the directions ``fields`` (S + 1, 3) for each of the hypotheses ``gyros`` (H, 3, 3).

    ``angles`` (S, B, 3) [rad] are the integrated rates in B parts of the intervals between the fields. Each hypothesis
    maps the published rates to the true ones.
    """
    found = np.empty(len(gyros))
    for h in range(len(gyros)):
        attitude, total = (1.0, 0.0, 0.0, 0.0), load3(fields[0], 0)
        for s in range(len(angles)):
            for first in range(0, angles.shape[1], _PART):
                part = (0.0, 0.0, 0.0)
                for b in range(first, min(first + _PART, angles.shape[1])):
                    part = add(part, load3(angles[s, b], 0))
                G = gyros[h]
                turn = dot(load3(G[0], 0), part), dot(load3(G[1], 0), part), dot(load3(G[2], 0), part)
                attitude = q_multiply(attitude, q_exp(turn))
            total = add(total, q_rotate(attitude, load3(fields[s + 1], 0)))
        found[h] = 1.0 - dot(total, total) / len(fields) ** 2
    return found
