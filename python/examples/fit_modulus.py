"""Fits Young's modulus of a slab to a force curve of a ball that was pressed into it.

    python fit_modulus.py
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

import sutura

Array = npt.NDArray[np.float64]

#: Radius of the ball [m]; it touches with its centre so far above the slab.
RADIUS_M = 0.010


def press(youngs_modulus_pa: float, depths_m: Array) -> Array:
    """Force along the way in at each depth [N], (k,)."""
    scene = sutura.scene(
        {
            "name": "Indentation",
            "mesh": {"slab": {"size_m": [0.06, 0.06, 0.03], "divisions": [10, 10, 5]}},
            "tissue": {"model": "linear", "youngs_modulus_pa": youngs_modulus_pa, "poisson_ratio": 0.45},
            "fixed": [{"plane": {"axis": "z", "at_m": -0.03}}],
            "tool": [{"radius_m": RADIUS_M}],
        }
    )
    solver = sutura.Solver(scene)
    forces_n = np.empty_like(depths_m)
    for index, depth_m in enumerate(depths_m):
        step = solver.step([0.0, 0.0, RADIUS_M - depth_m], most_steps=1000)
        if step.status != "ok":
            raise sutura.SolveError(f"no balance {1e3 * depth_m:.2f} mm deep: {step.status}")
        forces_n[index] = step.wrench()[2]
    return forces_n


def fit(measured_n: Array, depths_m: Array, model: Callable[[float, Array], Array] = press) -> tuple[float, float]:
    """Modulus of the least squares and its standard deviation [Pa], of errors of equal size at all depths."""
    # By its logarithm, so that it stays above zero.
    found = least_squares(lambda log_pa: model(float(np.exp(log_pa[0])), depths_m) - measured_n, [np.log(5e3)])
    modulus_pa = float(np.exp(found.x[0]))
    slope_n = found.jac[:, 0] / modulus_pa
    variance = np.square(found.fun).sum() / max(len(measured_n) - 1, 1)
    return modulus_pa, float(np.sqrt(variance / np.square(slope_n).sum()))


def main() -> None:
    """In place of a sensor: a slab of 12 kPa with 5 mN of noise."""
    depths_m = np.linspace(0.0005, 0.006, 12)
    measured_n = press(12e3, depths_m) + np.random.default_rng(1).normal(0.0, 0.005, depths_m.shape)
    modulus_pa, deviation_pa = fit(measured_n, depths_m)
    print(f"Young's modulus {1e-3 * modulus_pa:.2f} kPa, standard deviation {1e-3 * deviation_pa:.2f} kPa")


if __name__ == "__main__":
    main()
