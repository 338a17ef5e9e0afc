"""What a haptic step costs from Python beyond the same step from Rust, in pairs on one scene.

    python step_cost.py [SCENE]

A hand goes slowly up and down over the scene's tissue. Each round takes the same poses twice from the same moment: once in a loop
of Rust, once in a loop of Python, which takes the step and copies the wrench into an array. Which is first changes
with each round; the figure is the median over rounds of the difference of their medians. The exit code is 1 if that is more than
the bar.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np

import sutura

ROUNDS = 30
STEPS = 200
#: What a step from Python may cost more [us].
BAR_US = 10.0


def slab() -> sutura.Scene:
    return sutura.scene(
        {
            "name": "slab",
            "mesh": {"slab": {"size_m": [0.06, 0.06, 0.03], "divisions": [6, 6, 3]}},
            "tissue": {"model": "linear", "youngs_modulus_pa": 15e3, "poisson_ratio": 0.45},
            "fixed": [{"plane": {"axis": "z", "at_m": -0.03}}],
            "tool": [{"radius_m": 0.014}],
        }
    )


def main() -> int:
    scene = sutura.load(sys.argv[1]) if len(sys.argv) > 1 else slab()
    solver = sutura.Solver(scene)
    turn = 2.0 * np.pi * np.arange(STEPS) / STEPS
    positions_m = np.stack([0.0 * turn, 0.0 * turn, 0.013 + 0.001 * np.cos(turn)], axis=1)
    for position_m in positions_m:
        solver.step(position_m, most_steps=100)
    moment = solver.moment()
    wrench, given = np.empty(6), positions_m.tolist()

    def of_rust() -> float:
        solver.go_on_from(moment)
        return float(np.median(solver._steps_us(given)))

    def of_python() -> float:
        solver.go_on_from(moment)
        times_us = []
        for position_m in positions_m:
            start = time.perf_counter()
            solver.step(position_m).wrench(out=wrench)
            times_us.append(1e6 * (time.perf_counter() - start))
        return statistics.median(times_us)

    pairs = []
    for number in range(ROUNDS):
        if number % 2:
            python_us, rust_us = of_python(), of_rust()
        else:
            rust_us, python_us = of_rust(), of_python()
        pairs.append((rust_us, python_us))
    more_us = [python_us - rust_us for rust_us, python_us in pairs]
    cost_us = statistics.median(more_us)
    print(
        f"a step takes {statistics.median(r for r, _ in pairs):.1f} us from Rust, {statistics.median(p for _, p in pairs):.1f} us from "
        f"Python; {cost_us:.1f} us more in pairs (from {min(more_us):.1f} to {max(more_us):.1f}); "
        f"the bar is {BAR_US:.0f} us: {'held' if cost_us <= BAR_US else 'missed'}"
    )
    return int(cost_us > BAR_US)


if __name__ == "__main__":
    sys.exit(main())
