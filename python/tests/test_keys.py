"""Every key of a scene that changes a force: steps from Python feel what sessions feel, as host/tests/keys.rs asks of the rest."""

import copy
import tomllib

import numpy as np
import pytest
from conftest import ROOT

import sutura

FOLDER = ROOT / "tests" / "data"
TABLE = tomllib.loads((FOLDER / "scene-keys.toml").read_text())


def put(scene: dict, path: str, value: object) -> None:
    """Puts a value in the place of that at a path, whose numbers are places in lists."""
    *way, last = path.split(".")
    at: object = scene
    for key in way:
        at = at[int(key)] if isinstance(at, list) else at[key]
    at[int(last) if isinstance(at, list) else last] = value


def by_steps(described: dict, position_m: list[float]) -> float:
    """Force of single steps along the hand's way, which ends at a place, and of some more there [N]."""
    scene = sutura.scene(described, directory=FOLDER)
    solver = sutura.Solver(scene)
    points = described["hand"]["way_point"]
    times_s = [point["time_s"] for point in points]
    places_m = [point["position_m"] for point in points[:-2]] + [position_m] * 2
    steps = round(scene.seconds * scene.host_hz)
    for number in range(steps + 21):
        time_s = number / scene.host_hz
        at = [np.interp(time_s, times_s, [place[axis] for place in places_m]) for axis in range(3)]
        step = solver.step(at, time_s=time_s, most_steps=1000)
        assert step.status == "ok", time_s
    return float(np.linalg.norm(step.wrench()[:3]))


@pytest.mark.parametrize("case", TABLE["case"], ids=[case["name"] for case in TABLE["case"]])
def test_steps_feel_what_a_session_feels(case):
    described = copy.deepcopy(TABLE["base"][case["base"]])
    for path, value in case["set"]:
        put(described, path, copy.deepcopy(value))
    peak = sutura.run(sutura.scene(described, directory=FOLDER))["scene"]["peak"]
    assert peak["force_n"] > 0.05
    found_n = by_steps(described, peak["position_m"])
    assert found_n == pytest.approx(peak["force_n"], rel=case.get("tolerance", 1e-3))
