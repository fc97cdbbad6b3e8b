"""What the velocities of a receiver tell of the specific force from second to second."""

import numpy as np

from nav_pose_estimator.core.alignment.velocity_history import VelocityHistory

G = 9.81


def history(times: np.ndarray) -> VelocityHistory:
    """Velocities at ``times`` (N,) of a vehicle that speeds up to the East by 2 m/s^2."""
    found = VelocityHistory()
    for t in times.tolist():
        found.add(t, 2.0 * t, 0.0, 1.0)
    return found


def test_forces_are_accelerations_and_gravity() -> None:
    """GIVEN velocities between the seconds THEN each second has the acceleration, however late they are taken."""
    forces = history(np.arange(0.1, 9.0, 0.2)).forces(np.array([6.5, 7.0]), 6, G)
    assert forces is not None
    np.testing.assert_allclose(forces, np.broadcast_to([2.0, 0.0, G], (2, 6, 3)), atol=1e-9)


def test_nothing_is_told_across_a_gap_or_beyond_the_ends() -> None:
    """GIVEN velocities with a gap, or of a part of the window THEN nothing is told."""
    gap = np.r_[np.arange(0.0, 3.0, 0.2), np.arange(4.2, 9.0, 0.2)]
    assert history(gap).forces(np.array([7.0]), 6, G) is None
    assert history(np.arange(1.1, 9.0, 0.2)).forces(np.array([7.0]), 6, G) is None
    assert history(np.arange(0.0, 6.9, 0.2)).forces(np.array([7.0]), 6, G) is None


def test_old_velocities_are_forgotten_and_late_ones_not_taken() -> None:
    """GIVEN more velocities than are kept WHEN one comes late THEN the newest ones tell as before."""
    found = history(np.arange(0.0, 50.0, 0.1))
    found.add(40.0, 1e3, 1e3, 1e3)
    found.forget_before(40.0)
    assert found.forces(np.array([48.0]), 9, G) is None
    forces = found.forces(np.array([48.0]), 6, G)
    assert forces is not None
    np.testing.assert_allclose(forces[0, :, 0], 2.0, atol=1e-9)
