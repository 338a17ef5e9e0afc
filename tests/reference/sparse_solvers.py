"""Sutura's factor and solves beside MKL PARDISO on the same matrices, one thread each, in one run.

The matrices are assembled here from the same meshes and material as `sutura bench --suite`, whose figures
are read from its JSON. Figures are medians; ratios above 1 mean that Sutura is faster.

    python -m venv venv && venv/bin/pip install numpy==2.4.6 scipy==1.17.1 pypardiso==0.4.7
    cargo build --release
    venv/bin/python tests/reference/sparse_solvers.py target/release/sutura
"""

import ctypes
import json
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np
import scipy.sparse as sp
from pypardiso import PyPardisoSolver

DATA = Path(__file__).resolve().parent.parent / "data"
YOUNG, POISSON = 50e3, 0.45
REPEATS = 15


def read_msh(path):
    """Points and tetrahedra of a gmsh 4.1 ASCII file, nodes in file order."""
    lines = iter(path.read_text().split("\n"))
    points, cells, number = [], [], {}
    for line in lines:
        if line == "$Nodes":
            for _ in range(int(next(lines).split()[0])):
                count = int(next(lines).split()[3])
                tags = [int(next(lines)) for _ in range(count)]
                for tag in tags:
                    number[tag] = len(points)
                    points.append([float(x) for x in next(lines).split()])
        if line == "$Elements":
            for _ in range(int(next(lines).split()[0])):
                _, _, kind, count = (int(x) for x in next(lines).split())
                for _ in range(count):
                    row = [int(x) for x in next(lines).split()]
                    if kind == 4:
                        cells.append([number[tag] for tag in row[1:]])
    return np.array(points), np.array(cells)


PATHS = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)]


def tube(inner, outer, low, high, divisions):
    nr, around, nz = divisions
    node = lambda i, j, k: i + (nr + 1) * (j % around + around * k)
    k, j, i = np.meshgrid(np.arange(nz + 1), np.arange(around), np.arange(nr + 1), indexing="ij")
    radius, angle = inner + (outer - inner) * i / nr, 2 * np.pi * j / around
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), low + (high - low) * k / nz], -1).reshape(-1, 3)
    cells = []
    for start in np.ndindex(nr, around, nz):
        for path in PATHS:
            corner = list(start)
            cell = [node(*corner)]
            for axis in path:
                corner[axis] += 1
                cell.append(node(*corner))
            cells.append(cell)
    return points, np.array(cells)


def two_tubes(divisions):
    upper, lower = tube(0.008, 0.011, 0.003, 0.033, divisions), tube(0.012, 0.015, -0.031, -0.003, divisions)
    return np.vstack([upper[0], lower[0]]), np.vstack([upper[1], lower[1] + len(upper[0])])


def stiffness(points, cells):
    """Upper triangle over the free unknowns, both ends held."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.abs(np.linalg.det(edges)) / 6
    inverse = np.linalg.inv(edges)
    gradients = np.concatenate([-inverse.sum(2, keepdims=True), inverse], 2).transpose(0, 2, 1)
    lam = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    mu = YOUNG / (2 * (1 + POISSON))
    outer = np.einsum("eai,ebj->eabij", gradients, gradients)
    shear = np.einsum("eak,ebk->eab", gradients, gradients)
    blocks = lam * outer + mu * outer.transpose(0, 1, 2, 4, 3) + mu * np.einsum("eab,ij->eabij", shear, np.eye(3))
    blocks *= volume[:, None, None, None, None]
    unknown = 3 * cells[:, :, None] + np.arange(3)
    rows = np.broadcast_to(unknown[:, :, None, :, None], blocks.shape).ravel()
    columns = np.broadcast_to(unknown[:, None, :, None, :], blocks.shape).ravel()
    n = 3 * len(points)
    matrix = sp.coo_matrix((blocks.ravel(), (rows, columns)), (n, n)).tocsr()
    z = points[:, 2]
    free = np.repeat((z > z.min() + 1e-7) & (z < z.max() - 1e-7), 3)
    return sp.triu(matrix[free][:, free], format="csr")


def median_ms(action):
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        action()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))


def pardiso(matrix):
    """Called as from C: arrays prepared once, no iterative refinement, no checks."""
    call = PyPardisoSolver()._mkl_pardiso
    n = matrix.shape[0]
    handle = np.zeros(64, np.int64)
    iparm = np.zeros(64, np.int32)
    # Own settings, METIS ordering, indices from 0.
    iparm[0], iparm[1], iparm[34] = 1, 2, 1
    values = np.ascontiguousarray(matrix.data)
    starts, columns = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
    permutation = np.zeros(n, np.int32)
    pointer = lambda array, kind: array.ctypes.data_as(ctypes.POINTER(kind))
    integer = lambda value: ctypes.byref(ctypes.c_int32(value))

    def phase(number, count=1, rhs=None, x=None):
        rhs = np.zeros(n * count) if rhs is None else rhs
        x = np.zeros(n * count) if x is None else x
        error = ctypes.c_int32(0)
        arguments = [
            pointer(handle, ctypes.c_int64), integer(1), integer(1), integer(2), integer(number), integer(n),
            pointer(values, ctypes.c_double), pointer(starts, ctypes.c_int32), pointer(columns, ctypes.c_int32),
            pointer(permutation, ctypes.c_int32), integer(count), pointer(iparm, ctypes.c_int32), integer(0),
            pointer(rhs, ctypes.c_double), pointer(x, ctypes.c_double), ctypes.byref(error),
        ]
        call(*arguments)
        assert error.value == 0, error.value
        return x

    analysis = median_ms(lambda: phase(11))
    numeric = median_ms(lambda: phase(22))
    one, sixty = np.ones(n), np.ones(60 * n)
    x, many = np.zeros(n), np.zeros(60 * n)
    figures = {
        "factor_ms": analysis + numeric,
        "numeric_ms": numeric,
        "solve_us": 1e3 * median_ms(lambda: phase(33, 1, one, x)),
        "column_us": 1e3 * median_ms(lambda: phase(33, 60, sixty, many)) / 60,
    }
    full = matrix + sp.triu(matrix, 1).T
    residual = np.abs(full @ x - one).max()
    assert residual < 1e-6, residual
    return figures


def main(sutura):
    run = subprocess.run([sutura, "bench", "--suite", "--steps", "100", "--format", "json"], stdout=subprocess.PIPE, check=True)
    cases = {case["scene"]: case for case in json.loads(run.stdout)["cases"] if case["tissue"] == "linear" and case.get("rows") == 60 and "field_us" in case}
    meshes = {
        "circling on tubes 1,650": (lambda m: (m[0] * 1e-3, m[1]))(read_msh(DATA / "tubes_younes.msh")),
        "circling on cylinder 1,650": (lambda m: (m[0] * 0.03, m[1]))(read_msh(DATA / "cylinder_1650.msh")),
        "circling on tubes 5 k": two_tubes((2, 56, 14)),
        "circling on tubes 20 k": two_tubes((4, 84, 23)),
    }
    table = []
    for name, mesh in meshes.items():
        matrix = stiffness(*mesh)
        case, other = cases[name], pardiso(matrix)
        ours = {"factor_ms": case["factor_ms"], "solve_us": case["field_us"], "column_us": case["column_us"]}
        ratios = {key: other[key] / ours[key] for key in ours}
        table.append({"matrix": name.removeprefix("circling on "), "unknowns": matrix.shape[0], "sutura": ours, "pardiso": other, "ratio": ratios})
        print(f"{name}: {matrix.shape[0]} unknowns; factor {ratios['factor_ms']:.2f}, one solve {ratios['solve_us']:.2f}, a column among many {ratios['column_us']:.2f}", file=sys.stderr)
    print(json.dumps(table, indent=1))


if __name__ == "__main__":
    main(sys.argv[1])
