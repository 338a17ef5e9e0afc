"""A gymnasium environment of needle driving: bring a needle's tip through a slab, with little force.

    python needle_driving.py
"""

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

import sutura

Array = npt.NDArray[np.float64]

#: Of the slab [m].
THICKNESS_M = 0.008
#: Of the needle [m].
LENGTH_M = 0.030
#: So far above the slab the tip begins [m].
ABOVE_M = 0.004
#: Most way of the grip in one step along each axis [m].
STEP_M = 0.0005
#: Beyond what an episode comes to: way of the grip [mm], force on it along each axis [N].
MOST_WAY_MM, MOST_N = 200.0, 100.0
#: What a newton on the grip costs in a step, where a millimetre of the way pays 1.
COST_PER_N = 0.05

SCENE = {
    "name": "A needle and a slab",
    "mesh": {"slab": {"size_m": [0.03, 0.03, THICKNESS_M], "divisions": [7, 7, 3]}},
    "tissue": {
        "model": "linear",
        "youngs_modulus_pa": 30e3,
        "poisson_ratio": 0.45,
        "needle": {
            "friction_n_per_m": 25.0,
            "static_friction_n_per_m": 30.0,
            "cutting_pa": 1e5,
            "puncture_pa": 5e5,
        },
    },
    "fixed": [{"plane": {"axis": "x", "at_m": side}} for side in (-0.015, 0.015)],
    "tool": [{"id": 0, "shape": "grip"}],
    "needle": [
        {
            "shape": "straight",
            "length_m": LENGTH_M,
            "thickness_m": 0.0008,
            # Beside the mesh's own lines.
            "end_m": [0.0011, 0.0007, LENGTH_M + ABOVE_M],
            "direction": [0.0, 0.0, -1.0],
            "hold": [{"time_s": 0.0, "tool": 0}],
        }
    ],
}


class NeedleDriving(gymnasium.Env[Array, Array]):
    """Moves the grip by `action` times `STEP_M`, (3,), each from -1 to 1.

    Observed, (7,): the grip's way from where it began [mm], force on the grip [N], and boundaries broken through. Paid: the way
    that the grip goes on downwards [mm], less what force costs. It ends when the tip is out of the slab below.
    """

    def __init__(self) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float64)
        most = np.array([*3 * [MOST_WAY_MM], *3 * [MOST_N], 100.0])
        self.observation_space = gymnasium.spaces.Box(-most, most, dtype=np.float64)
        self._solver = sutura.Solver(sutura.scene(SCENE))
        self._began_m = np.array([0.0011, 0.0007, LENGTH_M + ABOVE_M])
        self._grip_m = self._began_m.copy()
        self._step = self._solver.step(self._grip_m)
        # To begin anew costs no factorisation.
        self._first = self._solver.moment()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        self._solver.go_on_from(self._first)
        self._grip_m = self._began_m.copy()
        self._step = self._solver.step(self._grip_m)
        return self._observed(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        went_m = STEP_M * np.clip(action, -1.0, 1.0)
        self._grip_m = self._grip_m + went_m
        step = self._solver.step(self._grip_m, most_steps=100)
        # What has no balance is not felt, and ends the episode.
        lost = not step.has_balance
        self._step = self._step if lost else step
        observed = self._observed()
        reward = -1e3 * went_m[2] - COST_PER_N * float(np.linalg.norm(observed[3:6]))
        # In at the top and out at the bottom, which gives way before it breaks.
        through = any(needle.punctures >= 2 and needle.tip == "outside" for needle in self._step.needles)
        return observed, float(reward), through, lost, {"status": step.status}

    def _observed(self) -> Array:
        punctures = sum(needle.punctures for needle in self._step.needles)
        way_mm = 1e3 * (self._grip_m - self._began_m)
        return np.concatenate([way_mm, self._step.wrench()[:3], [punctures]])


def drive(environment: NeedleDriving, action: Array, most: int = 200) -> tuple[float, Array, bool]:
    """What an episode of one action pays, what is observed last, and whether the needle came through."""
    observed, _ = environment.reset(seed=1)
    paid = 0.0
    for _ in range(most):
        observed, reward, through, lost, _ = environment.step(action)
        paid += reward
        if through or lost:
            return paid, observed, through
    return paid, observed, False


def main() -> None:
    paid, observed, through = drive(NeedleDriving(), np.array([0.0, 0.0, -1.0]))
    print(f"straight down: {'through' if through else 'not through'}, {observed[6]:.0f} boundaries, paid {paid:.1f}")


if __name__ == "__main__":
    main()
