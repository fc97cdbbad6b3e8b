"""The Earth: published values, and turns between coordinates that must come back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_pose_estimator.core.earth import ellipsoid as earth

latitude = st.floats(-math.pi / 2, math.pi / 2)
longitude = st.floats(-math.pi, math.pi)
height = st.floats(-5e3, 1e6)


def test_gravity_has_its_published_values():
    # NIMA TR8350.2, table 3.4: equator, pole; mean gravity near latitude 45 deg
    assert earth.gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.gravity(math.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert earth.gravity(math.radians(45.0), 0.0) == pytest.approx(9.8061977, abs=1e-6)
    assert pytest.approx(0.00344978650684, rel=1e-10) == earth.GRAVITY_M
    assert pytest.approx(6.69437999014e-3, rel=1e-11) == earth.E2


@given(latitude)
def test_gravity_falls_with_height_like_newton(lat):
    slope = (earth.gravity(lat, 1000.0) - earth.gravity(lat, -1000.0)) / 2000.0
    assert slope == pytest.approx(-3.086e-6, rel=3e-3)


def test_radii_have_their_closed_forms():
    equator, pole = earth.radii(0.0), earth.radii(math.pi / 2)
    assert equator == pytest.approx((earth.B**2 / earth.A, earth.A))
    assert pole == pytest.approx((earth.A**2 / earth.B, earth.A**2 / earth.B))


@given(latitude, longitude, height)
def test_ecef_comes_back(lat, lon, h):
    lat_2, lon_2, h_2 = earth.ecef_to_lla(earth.lla_to_ecef(lat, lon, h))
    assert lat_2 == pytest.approx(lat, abs=2e-15)
    assert h_2 == pytest.approx(h, abs=5e-9)
    assert math.remainder(lon_2 - lon, 2.0 * math.pi) * math.cos(lat) == pytest.approx(0.0, abs=2e-15)


@pytest.mark.parametrize(("h", "error"), [(-5e4, 2e-8), (4.2e7, 2e-8)])
def test_ecef_comes_back_far_from_the_surface(h, error):
    lat = np.linspace(-math.pi / 2, math.pi / 2, 181)
    lat_2, _, h_2 = earth.ecef_to_lla(earth.lla_to_ecef(lat, 1.0, h))
    assert np.abs(lat_2 - lat).max() * 6.4e6 < error
    assert np.abs(h_2 - h).max() < error


@given(st.floats(-1.5, 1.5), longitude, height, *[st.floats(-1e5, 1e5)] * 3)
def test_enu_comes_back(lat, lon, h, east, north, up):
    there = earth.enu_to_lla((east, north, up), lat, lon, h)
    assert np.allclose(earth.lla_to_enu(*there, lat, lon, h), (east, north, up), rtol=0.0, atol=1e-8)


def test_enu_points_east_north_up():
    enu = earth.lla_to_enu([0.8, 0.8 + 1e-6, 0.8], [0.2 + 1e-6, 0.2, 0.2], [100.0, 100.0, 101.0], 0.8, 0.2, 100.0)
    R_M, R_N = earth.radii(0.8)
    expected = np.diag([(R_N + 100.0) * math.cos(0.8) * 1e-6, (R_M + 100.0) * 1e-6, 1.0])
    assert np.allclose(enu, expected, atol=1e-5)


@given(latitude, height)
def test_numpy_forms_equal_the_kernels(lat, h):
    assert np.allclose(earth.radii_many(lat), earth.radii(lat), rtol=1e-14)
    assert np.allclose(earth.gravity_many(lat, h), earth.gravity(lat, h), rtol=1e-14)


def test_leading_dimensions_are_kept():
    lat, lon, h = np.full((2, 3), 0.5), np.zeros((2, 3)), np.zeros((2, 3))
    assert earth.lla_to_ecef(lat, lon, h).shape == (2, 3, 3)
    assert earth.lla_to_enu(lat, lon, h, 0.5, 0.0, 0.0).shape == (2, 3, 3)


@pytest.mark.parametrize("lat", [math.pi / 2, -math.pi / 2])
def test_a_pole_is_finite(lat):
    assert earth.cos_latitude(lat) == earth.MIN_COS_LAT
    assert earth.ecef_to_lla(earth.lla_to_ecef(lat, 0.3, 10.0))[2] == pytest.approx(10.0, abs=1e-8)


@given(st.floats(-1.5, 1.5), longitude, height, *[st.floats(-0.01, 0.01)] * 2, st.floats(-1e3, 1e3))
def test_one_point_and_many_agree(lat, lon, h, d_lat, d_lon, d_h):
    there = lat + d_lat, lon + d_lon, h + d_h
    assert np.allclose(earth.ecef_of(*there), earth.lla_to_ecef(*there), rtol=0.0, atol=1e-8)
    assert np.allclose(earth.enu_of(*there, lat, lon, h), earth.lla_to_enu(*there, lat, lon, h), rtol=0.0, atol=1e-7)
