"""Steps: what is felt is physics, arrays are one's own, and two threads do not share a solver."""

import signal
import threading
import time

import numpy as np
import pytest
from conftest import ROOT

import sutura

PRESSED = [0.0, 0.0, 0.009]


def test_force_is_up_and_the_tangent_is_its_derivative(solver):
    step = solver.step(PRESSED, most_steps=100)
    assert step.status == "ok" and step.rows > 0
    here_n, tangent = step.wrench()[:3], step.tangent()[:3, :3]
    assert here_n[2] > 0.1 and tangent[2, 2] < 0.0
    for axis in range(3):
        way_m = np.zeros(3)
        way_m[axis] = 1e-7
        ends = [solver.step(PRESSED + sign * way_m, most_steps=100).wrench()[:3] for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / 2e-7
        assert slope == pytest.approx(tangent[:, axis], abs=1e-3 * abs(tangent[2, 2]))


def test_work_of_the_hand_is_the_energy_in_the_tissue(solver):
    heights_m = np.linspace(0.014, 0.009, 51)
    steps = [solver.step([0.0, 0.0, height_m], most_steps=100) for height_m in heights_m]
    force_n = np.array([step.wrench()[2] for step in steps])
    work_j = -np.sum(0.5 * (force_n[1:] + force_n[:-1]) * np.diff(heights_m))
    assert work_j == pytest.approx(steps[-1].stored_energy_j, rel=1e-2)


def test_where_the_ball_is_the_tissue_is_not(solver):
    solver.step(PRESSED, most_steps=100)
    positions_m = solver.positions_m()
    assert np.linalg.norm(positions_m - PRESSED, axis=1).min() > 0.014 - 1e-6
    displacement_m = solver.displacement_m()
    assert displacement_m[:, 2].min() == pytest.approx(-0.005, rel=0.05)
    stress_pa = solver.stress_pa()
    # Descending, and pressed together below the ball.
    assert (np.diff(stress_pa, axis=1) <= 0.0).all() and stress_pa.min() < -500.0


def test_results_are_fresh_or_in_out(solver):
    step = solver.step(PRESSED, most_steps=100)
    fresh = step.wrench()
    fresh[:] = 7.0
    assert (step.wrench() != 7.0).all()
    rows = np.zeros((3, 6))
    assert step.wrench(out=rows[1]).base is rows
    assert (rows[1] == step.wrench()).all() and not rows[[0, 2]].any()
    positions_m = np.empty_like(solver.positions_m())
    before = solver.positions_m(out=positions_m).copy()
    solver.step([0.0, 0.0, 0.02])
    assert (positions_m == before).all()


@pytest.mark.parametrize(
    ("out", "said"),
    [
        (np.zeros(5), r"out has the shape \(5,\): give .* float64 with the shape \(6,\)"),
        (np.zeros(6, np.float32), "out is of float32: give"),
        (np.zeros(12)[::2], "out is not contiguous: give"),
        ([0.0] * 6, "list"),
    ],
)
def test_a_wrong_out_is_named(solver, out, said):
    with pytest.raises((TypeError, ValueError), match=said):
        solver.step(PRESSED, most_steps=100).wrench(out=out)


def test_a_read_only_out_is_left_alone(solver):
    out = np.zeros(6)
    out.setflags(write=False)
    with pytest.raises(ValueError, match="cannot be written"):
        solver.step(PRESSED, most_steps=100).wrench(out=out)


@pytest.mark.parametrize(
    ("arguments", "named", "said"),
    [
        (([0.0, 0.0],), {}, "position_m has 2 numbers: give 3"),
        (([0.0, 0.0, np.nan],), {}, r"position_m\[2\] is NaN: give finite"),
        (("above",), {}, "position_m"),
        ((PRESSED, [0.0, 0.0, 0.0, 2.0]), {}, "orientation has the length 2: give a unit quaternion"),
        ((PRESSED,), {"time_s": -1.0}, "time_s is -1: give a time from"),
        ((PRESSED,), {"most_steps": 0}, "most_steps is 0"),
        ((PRESSED,), {"tools": {9: (PRESSED, [0, 0, 0, 1])}}, r"tools\[9\]"),
    ],
)
def test_a_wrong_argument_is_named_and_nothing_moves(solver, arguments, named, said):
    solver.step([0.0, 0.0, 0.01], most_steps=100)
    before = solver.hash()
    with pytest.raises((ValueError, TypeError, KeyError), match=said):
        solver.step(*arguments, **named)
    assert solver.hash() == before


def test_needle_and_thread_are_told_with_their_lines():
    solver = sutura.Solver(sutura.load(ROOT / "scenes/needle-slabs.toml"))
    # 40 mm long, its end in the grip; the upper slab lies from 4 to 12 mm.
    for end_m in np.arange(0.060, 0.0465, -0.0005):
        step = solver.step([0.0011, 0.0007, end_m], most_steps=20)
        assert step.has_balance
    (needle,) = step.needles
    assert (needle.tip, needle.punctures, needle.held_by) == ("inside", 1, 0)
    # 25 N/m over 5 mm, and what cuts on.
    assert -0.5 < needle.axial_n < -0.1
    assert step.wrench()[2] == pytest.approx(-needle.axial_n, rel=0.05)
    path_m = solver.needle_path_m(0)
    assert path_m[:, 2].max() - path_m[:, 2].min() == pytest.approx(0.04, rel=1e-3)
    with pytest.raises(KeyError, match="no needle has the id 1: the scene's needles are"):
        solver.needle_path_m(1)

    solver = sutura.Solver(sutura.load(ROOT / "scenes/thread-over-shaft.toml"))
    step = solver.step([-0.0225, 0.0007, -0.006], most_steps=20)
    (thread,) = step.threads
    assert (thread.id, thread.punctures, thread.taut, thread.broken_off_m) == (0, 0, False, None)
    # From where its tail is held to the needle's end, without tension.
    ((at_m, tension_n),) = solver.thread_path(0)
    assert at_m == pytest.approx(np.array([[-0.045, 0.0007, 0.012], [0.0013, 0.0007, 0.032]]))
    assert not tension_n.any()


def test_another_tool_goes_where_it_is_put(slab):
    slab["tool"] = [{"id": 0, "radius_m": 0.01}, {"id": 1, "radius_m": 0.01, "position_m": [0.02, 0.0, 0.03]}]
    solver = sutura.Solver(sutura.scene(slab))
    away = [0.0, 0.0, 0.05]
    assert not solver.step(away, most_steps=100).wrench(1).any()
    upright = [0.0, 0.0, 0.0, 1.0]
    step = solver.step(away, tools={1: ([0.015, 0.0, 0.007], upright)}, most_steps=100)
    assert step.wrench(1)[2] > 0.05 and not step.wrench(0).any()
    # And stays there.
    assert solver.step(away, most_steps=100).wrench(1)[2] > 0.05
    with pytest.raises(KeyError, match="no contact of tool 5"):
        step.wrench(5)


def test_a_moment_is_gone_back_to_to_the_bit(solver):
    solver.step([0.0, 0.0, 0.011], most_steps=100)
    moment = solver.moment()
    first = solver.step(PRESSED, most_steps=100).wrench().tobytes(), solver.hash()
    solver.step([0.01, 0.0, 0.02], most_steps=100)
    solver.go_on_from(moment)
    assert (solver.step(PRESSED, most_steps=100).wrench().tobytes(), solver.hash()) == first


def test_a_solver_in_a_step_refuses_another_thread_and_lets_python_run(slab):
    slab["mesh"]["slab"]["divisions"] = [10, 10, 4]
    slab["tissue"]["model"] = "corotational"
    solver = sutura.Solver(sutura.scene(slab))
    ended, refused = threading.Event(), []

    def steps():
        for turn in range(2000):
            if refused:
                break
            try:
                solver.step([0.0, 0.0, 0.009 + 1e-3 * (turn % 2)], most_steps=100)
            except sutura.BusyError:
                pass
        ended.set()

    thread = threading.Thread(target=steps)
    thread.start()
    # This thread goes on only if a step leaves Python's lock, and then meets one under way.
    while not ended.is_set() and not refused:
        try:
            solver.hash()
        except sutura.BusyError as error:
            refused.append(str(error))
        time.sleep(0)
    thread.join()
    assert refused and "in use by another thread: give each thread a solver" in refused[0]


def test_ctrl_c_is_heard_while_a_solver_is_built():
    """A handler that raises at its third call: a build that looks for signals makes these calls, one that does not makes one at most."""
    large = {
        "name": "large",
        "mesh": {"slab": {"size_m": [0.3, 0.3, 0.1], "divisions": [45, 45, 15]}},
        "tissue": {"model": "linear", "youngs_modulus_pa": 15e3, "poisson_ratio": 0.45},
        "fixed": [{"plane": {"axis": "z", "at_m": -0.1}}],
        "tool": [{"radius_m": 0.03}],
    }
    scene = sutura.scene(large)
    calls = []

    def handler(_signal, _frame):
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
        with pytest.raises(KeyboardInterrupt):
            try:
                sutura.Solver(scene)
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert len(calls) == 3


@pytest.mark.parametrize("friction", [0.0, 0.1])
@pytest.mark.parametrize("model", ["linear", "corotational", "hyperelastic"])
@pytest.mark.parametrize("seconds", [0.5, pytest.param(5.0, marks=pytest.mark.full)])
def test_a_ball_is_pushed_out_or_said_to_be_inside(slab, model, friction, seconds):
    slab["tissue"]["model"] = model
    slab["tool"] = [{"radius_m": 0.014, "friction": friction}]
    solver = sutura.Solver(sutura.scene(slab))
    hardest_n = 0.0
    for depth_m in np.linspace(0.0, 0.025, round(200 * seconds) + 1):
        step = solver.step([0.0017, 0.0011, 0.014 - depth_m], most_steps=100)
        if step.status in ("inside", "not-converged"):
            hardest_n = 0.0
            continue
        force_n = step.wrench()[2]
        # Tissue that is not linear comes to balance over some steps, and the force may fall a little without a word.
        least_n = hardest_n - max(0.02 * hardest_n, 0.03) if model == "linear" else 0.0
        assert step.status == "ok" and force_n >= least_n, (depth_m, force_n, hardest_n)
        assert depth_m < 0.002 or (step.rows > 0 and force_n > 0.03), depth_m
        hardest_n = max(hardest_n, force_n)


def test_no_ball_goes_through_tissue_in_one_step(slab):
    solver = sutura.Solver(sutura.scene(slab))
    assert solver.step([0.001, 0.0007, 0.05]).status == "ok"
    assert solver.step([0.001, 0.0007, -0.2], most_steps=100).status == "inside"
    # What is held is a wall: it is outside again on its own side of that.
    assert solver.step([0.001, 0.0007, -0.2], most_steps=100).status == "inside"
    step = solver.step([0.001, 0.0007, 0.05], most_steps=100)
    assert (step.status, step.rows) == ("ok", 0)
    assert solver.step([0.001, 0.0007, -0.015], most_steps=100).status == "inside"
