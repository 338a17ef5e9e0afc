"""Static balance of hand, sphere and slab at the deepest point of the palpation scene.

Independent of Sutura in mesh code, assembly and algorithm: scikit-fem assembles, SuperLU solves the full
sparse system in (displacement, tool position), contact by an augmented Lagrangian with exact curvature.
Parameters come from the scene file, so the two cannot drift apart.

    python -m venv venv && venv/bin/pip install numpy==2.4.6 scipy==1.17.1 scikit-fem==12.0.2
    venv/bin/python tests/reference/palpation_peak.py scenes/palpation-frictionless.toml > tests/data/palpation-peak.json
"""

import itertools
import json
import platform
import sys
import tomllib

import numpy as np
import scipy
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import skfem
from skfem.models.elasticity import lame_parameters, linear_elasticity


def slab(size, divisions):
    """Kuhn's six tetrahedra a cube, mirrored in every odd cube; top at z = 0, centred in x and y."""
    nx, ny, nz = divisions
    x = np.linspace(-size[0] / 2, size[0] / 2, nx + 1)
    y = np.linspace(-size[1] / 2, size[1] / 2, ny + 1)
    z = np.linspace(-size[2], 0.0, nz + 1)
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(nx + 1, ny + 1, nz + 1)
    cells = []
    for cube in itertools.product(range(nx), range(ny), range(nz)):
        start = np.array([c + c % 2 for c in cube])
        step = np.array([1 - 2 * (c % 2) for c in cube])
        for order in itertools.permutations(range(3)):
            corner = start.copy()
            cell = [number[tuple(corner)]]
            for axis in order:
                corner[axis] += step[axis]
                cell.append(number[tuple(corner)])
            cells.append(cell)
    return grid, np.array(cells)


def stiffness(points, cells, young, poisson):
    mesh = skfem.MeshTet(points.T, cells.T)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()))
    matrix = skfem.asm(linear_elasticity(*lame_parameters(young, poisson)), basis)
    # From scikit-fem's numbering to three unknowns a node, in the order of `points`.
    order = basis.nodal_dofs.T.reshape(-1)
    return sp.csr_matrix(matrix)[order][:, order].tocsc()


def balance(scene, log):
    mesh = scene["mesh"]["slab"]
    tissue = scene["tissue"]
    points, cells = slab(mesh["size_m"], mesh["divisions"])
    matrix = stiffness(points, cells, tissue["youngs_modulus_pa"], tissue["poisson_ratio"])
    (plane,) = [fixed["plane"] for fixed in scene["fixed"]]
    axis = "xyz".index(plane["axis"])
    free = np.flatnonzero(np.abs(points[:, axis] - plane["at_m"]) > 1e-9)
    unknowns = (3 * free[:, None] + np.arange(3)).reshape(-1)
    matrix = matrix[unknowns][:, unknowns]

    (tool,) = scene["tool"]
    radius = tool["radius_m"]
    offset = np.array(tool.get("offset_m", [0.0, 0.0, 0.0]))
    hand = scene["hand"]["stiffness_n_per_m"]
    target = min((np.array(w["position_m"], float) for w in scene["hand"]["way_point"]), key=lambda p: p[2])
    target = target + offset

    # Nodes that the sphere could reach: near the axis, on top.
    place = points[free]
    near = np.flatnonzero((place[:, 2] > -1e-9) & (np.hypot(*(place - target).T[:2]) < 2 * radius))
    n = len(unknowns)
    columns = (3 * near[:, None] + np.arange(3)).reshape(-1)

    u = np.zeros(n)
    centre = target.copy()
    centre[2] = radius  # just touching
    multiplier = np.zeros(len(near))
    penalty = 50.0 * tissue["youngs_modulus_pa"] * mesh["size_m"][0] / mesh["divisions"][0]
    newtons = 0
    for outer in range(60):
        for inner in range(60):
            arm = place[near] + u.reshape(-1, 3)[near] - centre
            distance = np.linalg.norm(arm, axis=1)
            normal = arm / distance[:, None]
            gap = distance - radius
            push = np.maximum(0.0, multiplier - penalty * gap)
            gradient = matrix @ u
            np.subtract.at(gradient, columns, (push[:, None] * normal).reshape(-1))
            tool_gradient = hand * (centre - target) + (push[:, None] * normal).sum(0)
            error = max(np.abs(gradient).max(), np.abs(tool_gradient).max())
            if error < 1e-12 * max(1.0, hand * 1e-2):
                break
            blocks = np.zeros((len(near), 3, 3))
            for i in np.flatnonzero(push > 0):
                outwards = np.outer(normal[i], normal[i])
                blocks[i] = penalty * outwards - push[i] / distance[i] * (np.eye(3) - outwards)
            rows = np.repeat(columns.reshape(-1, 3), 3, axis=1).reshape(-1)
            cols = np.tile(columns.reshape(-1, 3), (1, 3)).reshape(-1)
            hessian = matrix + sp.coo_matrix((blocks.reshape(-1), (rows, cols)), shape=(n, n))
            coupling = np.zeros((n, 3))
            coupling[columns] = -blocks.reshape(-1, 3)
            tool_hessian = hand * np.eye(3) + blocks.sum(0)
            system = sp.bmat([[hessian, coupling], [coupling.T, tool_hessian]], format="csc")
            factor = spla.splu(
                system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True}
            )
            step = -factor.solve(np.concatenate([gradient, tool_gradient]))
            # No step longer than a tenth of the radius: the set of pushed nodes finds itself.
            step *= min(1.0, 0.1 * radius / np.abs(step).max())
            u += step[:n]
            centre += step[n:]
            newtons += 1
        deepest = max(0.0, (-gap).max())
        pulling = np.abs(np.minimum(gap, multiplier / penalty)).max()
        print(f"{outer}: {newtons} Newton steps, balance {error:.1e} N, depth {deepest:.1e} m, {push.sum():.9f} N", file=log)
        multiplier = push
        if pulling < 1e-13 and deepest < 1e-13:
            break
    force = -(push[:, None] * normal).sum(0)
    energy = 0.5 * u @ (matrix @ u)
    return {
        "force_on_tool_n": force.tolist(),
        "force_n": float(np.linalg.norm(force)),
        "position_m": (centre - offset).tolist(),
        "hand_target_m": (target - offset).tolist(),
        "touched_vertices": int((push > 0).sum()),
        "stored_energy_j": float(energy),
        "deepest_penetration_m": float(deepest),
        "unbalanced_n": float(error),
        "nodes": len(points),
        "cells": len(cells),
    }


def main():
    path = sys.argv[1]
    with open(path, "rb") as file:
        scene = tomllib.load(file)
    result = balance(scene, sys.stderr)
    origin = {
        "command": f"python tests/reference/palpation_peak.py {path}",
        "method": "scikit-fem assembly, augmented Lagrangian in (u, c), SuperLU",
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-fem": skfem.__version__ if hasattr(skfem, "__version__") else "12.0.2",
        },
    }
    print(json.dumps({"origin": origin, **result}, indent=2))


if __name__ == "__main__":
    main()
