"""The classic artefacts of skinning, measured on a cylinder that is bent or twisted in its middle."""

import pytest
from cylinder import SCHEMES, bulge, cross_section, posed_cylinder, thickness


def test_a_half_twist_pinches_linear_blending_only():
    """The candy wrapper: opposite halves cancel, so of the cross-section nothing is left."""
    left = {scheme: cross_section(posed_cylinder(scheme, "twist", 180.0)[0]) for scheme in SCHEMES}
    assert left["linear"] < 1e-6
    for scheme in ("rigid", "dual_quaternion", "swing_twist"):
        assert left[scheme] == pytest.approx(1.0, abs=1e-6)
    # at a right angle the ring's radius is cos(45 degrees) under linear blending
    assert cross_section(posed_cylinder("linear", "twist", 90.0)[0]) == pytest.approx(0.5, abs=1e-6)


def test_a_bend_bulges_under_dual_quaternions_only():
    """Dual quaternions turn each ring about the joint, so that none comes nearer to it; linear
    blending takes the ring in the middle to the chord, at a half of the radius for 120 degrees."""
    bent = {scheme: posed_cylinder(scheme, "swing", 120.0)[0] for scheme in SCHEMES}
    bulges = {scheme: bulge(vertices, 120.0) for scheme, vertices in bent.items()}
    assert bulges["dual_quaternion"] > 0.2
    assert 0.0 < bulges["linear"] < 0.03
    assert bulges["swing_twist"] == pytest.approx(bulges["linear"], abs=1e-9)
    assert bulges["rigid"] == pytest.approx(0.0, abs=1e-6)
    assert thickness(bent["dual_quaternion"]) == pytest.approx(1.0, abs=1e-6)
    assert thickness(bent["swing_twist"]) == pytest.approx(0.5, abs=1e-6)
