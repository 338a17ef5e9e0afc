"""Rigid frictionless sphere on a cylinder of linear tissue glued at its bottom: force by depth.

    pip install numpy scipy scikit-fem
    python tests/reference/sphere.py > tests/data/sphere.json

Small strain in the tissue, contact where it is deformed to: nodes stay outside the sphere, whose normals are where
they come to. Axisymmetric, quadratic triangles, edges of at most 0.1 mm (square legs of 0.05 mm) within 3 mm of the
touch. The host's slab is square: its cylinder has the same area; the inscribed and the circumscribed one bound
what that leaves out. Hertz's force is for a half space.
"""

import json
import platform
import sys

import numpy as np
import scipy
import scipy.sparse.linalg
import skfem
from skfem import Basis, ElementTriP2, ElementVector, MeshTri
from skfem.helpers import grad

YOUNG, NU = 15e3, 0.45
RADIUS = 3e-3
# The host's slab: 5 x 5 x 2 cells at a radius of half a mean edge; its mean edge is (2 + sqrt 2) / 3 of a cell.
CELL = 2 * RADIUS * 3 / (2 + 2**0.5)
WIDTH, HEIGHT = 5 * CELL, 2 * CELL
DEPTHS = [0.5e-3, 1.5e-3]
FINE = 3e-3


def graded(fine, end, near):
    """From 0 to `near` in steps of `fine`, then ever longer ones to `end`."""
    at = list(np.linspace(0, near, round(near / fine) + 1))
    step = fine
    while at[-1] + step < end:
        step *= 1.12
        at.append(at[-1] + step)
    at[-1] = end
    return np.array(at)


def compliance(outer, fine):
    """Of the top's nodes within `FINE`: where they are (n), and what forces on their rings move them by (2n x 2n)."""
    r = graded(fine, outer, FINE)
    z = -graded(fine, HEIGHT, FINE)[::-1]
    mesh = MeshTri.init_tensor(r, z)
    basis = Basis(mesh, ElementVector(ElementTriP2()), intorder=4)
    lam, mu = YOUNG * NU / (1 + NU) / (1 - 2 * NU), YOUNG / 2 / (1 + NU)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        rr = w.x[0]
        du, dv = grad(u), grad(v)
        hoop_u, hoop_v = u[0] / rr, v[0] / rr
        trace_u = du[0, 0] + du[1, 1] + hoop_u
        trace_v = dv[0, 0] + dv[1, 1] + hoop_v
        shear = (du[0, 1] + du[1, 0]) * (dv[0, 1] + dv[1, 0])
        inner = 2 * du[0, 0] * dv[0, 0] + 2 * du[1, 1] * dv[1, 1] + 2 * hoop_u * hoop_v + shear
        return (lam * trace_u * trace_v + mu * inner) * 2 * np.pi * rr

    k = stiffness.assemble(basis)
    at = basis.doflocs
    bottom = np.flatnonzero(at[1] < -HEIGHT + 1e-9)
    vertical = np.zeros(at.shape[1], dtype=bool)
    for dofs in (basis.nodal_dofs, basis.facet_dofs):
        vertical[dofs[1]] = True
    axis = np.flatnonzero((at[0] < 1e-12) & ~vertical)
    fixed = np.union1d(bottom, axis)
    free = np.setdiff1d(np.arange(at.shape[1]), fixed)
    lu = scipy.sparse.linalg.splu(k[free][:, free].tocsc())
    top = np.flatnonzero((at[1] > -1e-12) & (at[0] < FINE + 1e-9))
    top_z = top[vertical[top]]
    top_z = top_z[np.argsort(at[0][top_z])]
    top_r = top[~vertical[top]]
    top_r = top_r[np.argsort(at[0][top_r])]
    dofs = np.concatenate([top_r, top_z])
    place = np.full(at.shape[1], -1)
    place[free] = np.arange(len(free))
    rhs = np.zeros((len(free), len(dofs)))
    for column, dof in enumerate(dofs):
        if place[dof] >= 0:
            rhs[place[dof], column] = 1
    moved = lu.solve(rhs)
    c = np.where(place[dofs][:, None] >= 0, moved[place[dofs]], 0)
    return at[0][top_z], c, len(free)


def press(r, c, depth):
    """Force on the sphere [N], and radius of what touches [m]: active sets in Newton's method."""
    n = len(r)
    centre = RADIUS - depth
    active = r < 0.7 * np.sqrt(RADIUS * depth)
    lam = np.zeros(n)
    u = np.zeros(2 * n)
    for _ in range(300):
        x, y = r + u[:n], u[n:] - centre
        length = np.hypot(x, y)
        gap, normal = length - RADIUS, np.array([x, y]) / length
        # Outward force lam on the tissue; linearised gap = 0 where active.
        which = np.flatnonzero(active)
        rows = np.zeros((len(which), 2 * n))
        rows[np.arange(len(which)), which] = normal[0, which]
        rows[np.arange(len(which)), n + which] = normal[1, which]
        target = rows @ u - gap[which]
        force = np.linalg.solve(rows @ c @ rows.T, target)
        new = c @ rows.T @ force
        lam[:] = 0
        lam[which] = force
        change = np.abs(new - u).max()
        u = u + (new - u) * (1 if change < 0.2e-3 else 0.2e-3 / change)
        x, y = r + u[:n], u[n:] - centre
        gap = np.hypot(x, y) - RADIUS
        after = (active & (lam > 0)) | (~active & (gap < -1e-12))
        # One ring at a time at the rim.
        if (after == active).all() and change < 1e-12:
            break
        if change < 1e-6:
            active = after
    else:
        raise RuntimeError("no balance")
    which = np.flatnonzero(active)
    y = u[n:] - centre
    length = np.hypot(r + u[:n], y)
    return float(-(lam * y / length).sum()), float((r + u[:n])[which].max())


def hertz(depth):
    return 4 / 3 * YOUNG / (1 - NU**2) * np.sqrt(RADIUS) * depth**1.5


def main():
    equal = WIDTH / np.sqrt(np.pi)
    cases = {}
    for name, outer, fine in [
        ("coarser", equal, 1e-4),
        ("finest", equal, 5e-5),
        ("inscribed", WIDTH / 2, 1e-4),
        ("circumscribed", WIDTH / np.sqrt(2), 1e-4),
    ]:
        r, c, unknowns = compliance(outer, fine)
        found = [press(r, c, depth) for depth in DEPTHS]
        cases[name] = (found, unknowns)
        print(name, unknowns, found, file=sys.stderr)
    forces = {name: [force for force, _ in found] for name, (found, _) in cases.items()}
    print(
        json.dumps(
            {
                "origin": {
                    "command": "python tests/reference/sphere.py",
                    "method": "axisymmetric, scikit-fem, quadratic triangles, nodes outside the sphere by active sets",
                    "versions": {
                        "python": platform.python_version(),
                        "numpy": np.__version__,
                        "scipy": scipy.__version__,
                        "scikit-fem": skfem.__version__,
                    },
                },
                "sphere_radius_m": RADIUS,
                "slab_size_m": [WIDTH, WIDTH, HEIGHT],
                "youngs_modulus_pa": YOUNG,
                "poisson_ratio": NU,
                "legs_m": 5e-5,
                "unknowns": cases["finest"][1],
                "depth_m": DEPTHS,
                "force_n": forces["finest"],
                "contact_radius_m": [radius for _, radius in cases["finest"][0]],
                "force_with_legs_of_0.1_mm_n": forces["coarser"],
                "force_on_inscribed_cylinder_n": forces["inscribed"],
                "force_on_circumscribed_cylinder_n": forces["circumscribed"],
                "hertz_n": [hertz(depth) for depth in DEPTHS],
            },
            indent=2,
        )
    )


main()
