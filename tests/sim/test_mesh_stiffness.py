"""The moduli given to a mesh: monotone, bounded, continuous where ν is capped."""

import pytest

from gelgap.sim.mesh_stiffness import LARGEST_POISSON_RATIO, mesh_moduli
from gelgap.sim.quality import QUALITIES

STIFFNESS = QUALITIES["draft"].disc.stiffness


@pytest.mark.parametrize("quality", QUALITIES.values())
@pytest.mark.parametrize("mesh", ["disc", "pad"])
def test_meshes_get_softer_moduli_and_never_more_than_the_largest_poisson_ratio(quality, mesh):
    stiffness = getattr(quality, mesh).stiffness
    for poisson_ratio in (0.0, 0.3, 0.45, 0.48, 0.49, 0.499):
        modulus, poisson = mesh_moduli(0.3, poisson_ratio, stiffness)
        assert poisson == min(poisson_ratio, LARGEST_POISSON_RATIO)
        assert 0.9 * 0.3 < modulus < 1.03 * 0.3


def test_cap_is_continuous_and_scales_with_the_modulus():
    below, above = (mesh_moduli(1.0, LARGEST_POISSON_RATIO + step, STIFFNESS)[0] for step in (-1e-9, 1e-9))
    assert below == pytest.approx(above, rel=1e-6)
    assert mesh_moduli(7.0, 0.495, STIFFNESS)[0] == pytest.approx(7 * mesh_moduli(1.0, 0.495, STIFFNESS)[0])
