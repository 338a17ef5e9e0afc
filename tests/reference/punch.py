"""Force of a rigid, frictionless flat punch on a cylinder glued at its bottom, by depth.

Independent of Sutura in geometry, elements and contact: the problem is axisymmetric, so scikit-fem solves it in
the half plane (r, z) with quadratic triangles graded towards the punch's rim, u_z prescribed under the disc,
everything else free. The mesh is halved twice and the stiffness extrapolated (Richardson) with the order seen.

    python -m venv venv && venv/bin/pip install numpy==2.4.6 scipy==1.17.1 scikit-fem==12.0.2
    venv/bin/python tests/reference/punch.py > tests/data/punch.json
"""

import json
import platform
import sys

import numpy as np
import scipy
import skfem
from skfem.helpers import grad

PUNCH = 0.010  # radius of the flat face [m]
RADIUS = 0.030  # of the cylinder [m]
HEIGHT = 0.020  # of the cylinder [m]
YOUNG = 15e3  # [Pa]
POISSON = 0.45


def graded(cells):
    """0 to 1, finer towards 0: the stress at the rim goes as one over the root of the distance."""
    return np.linspace(0.0, 1.0, cells + 1) ** 4


def mesh(cells, radius, height):
    """`cells` steps from the rim inwards, outwards and downwards."""
    inside = PUNCH * (1.0 - graded(cells)[::-1])
    outside = PUNCH + (radius - PUNCH) * graded(cells)
    down = height * graded(cells)
    return skfem.MeshTri.init_tensor(np.concatenate([inside, outside[1:]]), -down[::-1])


def stiffness(cells, radius=RADIUS, height=HEIGHT):
    """Force per depth [N/m]: the energy of unit depth, and the reaction, which must be the same."""
    basis = skfem.Basis(mesh(cells, radius, height), skfem.ElementVector(skfem.ElementTriP2()), intorder=6)
    shear = YOUNG / (2.0 * (1.0 + POISSON))
    bulk = YOUNG * POISSON / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))

    @skfem.BilinearForm
    def energy(u, v, w):
        r = w.x[0]
        du, dv = grad(u), grad(v)
        hoop_u, hoop_v = u[0] / r, v[0] / r
        volume_u = du[0, 0] + du[1, 1] + hoop_u
        volume_v = dv[0, 0] + dv[1, 1] + hoop_v
        slip_u, slip_v = du[0, 1] + du[1, 0], dv[0, 1] + dv[1, 0]
        direct = du[0, 0] * dv[0, 0] + du[1, 1] * dv[1, 1] + hoop_u * hoop_v
        density = bulk * volume_u * volume_v + 2.0 * shear * direct + shear * slip_u * slip_v
        return 2.0 * np.pi * r * density

    matrix = skfem.asm(energy, basis)
    x, y = basis.doflocs
    radial = np.zeros(len(x), bool)
    radial[np.concatenate([basis.nodal_dofs[0], basis.facet_dofs[0]])] = True
    bottom = np.isclose(y, -height)
    axis = radial & np.isclose(x, 0.0, atol=1e-12)
    pressed = ~radial & np.isclose(y, 0.0, atol=1e-12) & (x <= PUNCH * (1 + 1e-9))
    u = np.zeros(len(x))
    u[pressed] = -1.0
    held = np.flatnonzero(bottom | axis | pressed)
    u = skfem.solve(*skfem.condense(matrix, np.zeros(len(x)), x=u, D=held))
    reaction = -(matrix @ u)[pressed].sum()
    if abs(reaction / (u @ matrix @ u) - 1.0) > 1e-6:
        raise SystemExit("the reaction is not the slope of the energy")
    return reaction, len(x)


def main():
    cells = [12, 24, 48, 96]
    found = [stiffness(n) for n in cells]
    values = np.array([value for value, _ in found])
    steps = np.diff(values)
    ratio = steps[-2] / steps[-1]
    extrapolated = values[-1] + steps[-1] / (ratio - 1.0)
    half_space = 2.0 * YOUNG * PUNCH / (1.0 - POISSON**2)
    # A block so large that only 1 / size is left of its boundaries: Boussinesq's punch.
    block, larger = (stiffness(96, size, size)[0] for size in (40 * PUNCH, 80 * PUNCH))
    result = {
        "origin": {
            "command": "python tests/reference/punch.py",
            "method": "axisymmetric, scikit-fem, quadratic triangles graded towards the rim, Richardson",
            "versions": {
                "python": platform.python_version(),
                "numpy": np.__version__,
                "scipy": scipy.__version__,
                "scikit-fem": "12.0.2",
            },
        },
        "punch_radius_m": PUNCH,
        "cylinder_radius_m": RADIUS,
        "cylinder_height_m": HEIGHT,
        "youngs_modulus_pa": YOUNG,
        "poisson_ratio": POISSON,
        "cells_each_way": cells,
        "unknowns": [unknowns for _, unknowns in found],
        "stiffness_by_mesh_n_per_m": values.tolist(),
        "stiffness_n_per_m": float(extrapolated),
        "extrapolation_n_per_m": float(extrapolated - values[-1]),
        "half_space_n_per_m": half_space,
        "over_half_space": float(extrapolated / half_space),
        "large_block_over_half_space": float((2.0 * larger - block) / half_space),
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
