"""A network with weights by a formula, which do not depend on random generators."""

import numpy as np

from nav_pose_estimator.core.learning.conv_lstm import STEPS, ConvLstm, shapes


def formula_network(channels: int = 9, outputs: int = 6) -> ConvLstm:
    """Weights as large as those of a trained network, scales about one."""
    arrays = {}
    for number, (name, shape) in enumerate(shapes(channels, outputs).items()):
        wave = np.sin(0.37 * np.arange(np.prod(shape)) + number).reshape(shape)
        arrays[name] = (1.2 + 0.5 * wave if name.endswith("_scale") else 0.3 * wave).astype(np.float32)
    return ConvLstm.from_state(arrays)


def formula_window(channels: int = 9) -> np.ndarray:
    """(STEPS, channels)."""
    return np.sin(0.11 * np.arange(STEPS)[:, None] * (1.0 + np.arange(channels))) + 0.2 * np.arange(channels)
