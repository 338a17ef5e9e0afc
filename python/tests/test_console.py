"""A console of one's own: what is sent is felt, by the simulated one."""

import subprocess
import sys

import numpy as np
import pytest

import sutura


@pytest.fixture
def held(slab) -> dict:
    """A hand that comes down and stays, held by a spring."""
    return slab | {
        "device": "cartesian-bench",
        "hand": {
            "stiffness_n_per_m": 1000.0,
            "damping_n_s_per_m": 10.0,
            "way_point": [
                {"time_s": 0.0, "position_m": [0.0, 0.0, 0.016]},
                {"time_s": 0.2, "position_m": [0.0, 0.0, 0.010]},
            ],
        },
    }


def poses(console, seconds):
    """Poses for so long, by the console's clock."""
    first = None
    while (pose := console.pose()) is not None:
        first = pose.time_s if first is None else first
        if pose.time_s - first > seconds:
            return
        yield pose


def test_a_floor_that_is_sent_pushes_back(held):
    with sutura.Console.virtual(sutura.scene(held)) as console:
        assert console.is_simulated and console.is_connected and console.name == "cartesian-bench"
        console.arm()
        forces_n, heights_m = [], []
        for pose in poses(console, 1.5):
            depth_m = 0.013 - pose.position_m[2]
            up = [0.0, 0.0, 1.0]
            if depth_m > 0.0:
                stiffness = np.diag([0.0, 0.0, -500.0])
                console.send_contact(pose, [0.0, 0.0, 500.0 * depth_m], up, stiffness=stiffness)
            else:
                console.send_contact(pose, [0.0, 0.0, 0.0], up, gap_m=-depth_m)
            forces_n.append(pose.force_n[2])
            heights_m.append(pose.position_m[2])
        assert not pose.faults and pose.is_armed and pose.contact_age_s is not None
        # The hand's spring of 1000 N/m against a floor of 500 N/m, 3 mm above where the hand wants to be: 1 N, 11 mm high.
        rest = slice(len(forces_n) // 2, None)
        assert np.median(forces_n[rest]) == pytest.approx(1.0, rel=0.2)
        assert np.median(heights_m[rest]) == pytest.approx(0.011, abs=3e-4)


def test_a_step_of_a_scene_is_felt(held):
    scene = sutura.scene(held)
    solver = sutura.Solver(scene)
    with sutura.Console.virtual(scene) as console:
        console.arm()
        sent, largest_n = 0, 0.0
        for pose in poses(console, 1.5):
            step = solver.step(pose.position_m, pose.orientation, most_steps=8)
            sent += console.send_step(pose, step)
            largest_n = max(largest_n, pose.force_n[2])
        assert sent > 10 and largest_n > 0.05


def test_what_is_no_console_or_no_contact_is_named(held):
    with pytest.raises(sutura.ConsoleError, match="/dev/nowhere"):
        sutura.Console("/dev/nowhere")
    scene = sutura.scene(held)
    with pytest.raises(ValueError, match="horizon_s is -1: give a time from 0 to 3600 s"):
        sutura.Console.virtual(scene, horizon_s=-1.0)
    console = sutura.Console.virtual(scene)
    pose = console.pose(2.0)
    with pytest.raises(ValueError, match=r"force_n\[1\] is NaN: give finite numbers"):
        console.send_contact(pose, [0.0, np.nan, 0.0])
    with pytest.raises(ValueError, match=r"stiffness has the shape \(3,\): give \(3, 3\)"):
        console.send_contact(pose, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], stiffness=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="normal has the length 3: give a unit vector"):
        console.send_contact(pose, [0.0, 0.0, 1.0], [0.0, 0.0, 3.0])
    with pytest.raises(sutura.ConsoleError, match="not sent to the console"):
        console.send_contact(pose, [0.0, 0.0, 1e9], [0.0, 0.0, 1.0])
    console.close()
    console.close()
    with pytest.raises(sutura.ConsoleError, match="this console is closed"):
        console.arm()
    held.pop("hand")
    with pytest.raises(sutura.Error, match=r"no hand to hold a virtual console: add a \[hand\]"):
        sutura.Console.virtual(sutura.scene(held))


def test_a_session_in_real_time_is_felt(held):
    summary = sutura.run(sutura.scene(held), seconds=1.0, lockstep=False)
    assert summary["console"] == "virtual" and summary["mode"] in ("armed", "decaying", "idle")
    assert summary["ticks"] > 500 and summary["contact_steps"] > 0
    with pytest.raises(ValueError, match="runs by its own clock: lockstep=True goes with console='virtual'"):
        sutura.run(sutura.scene(held), console="/dev/nowhere", lockstep=True)
    with pytest.raises(sutura.ConsoleError, match="/dev/nowhere"):
        sutura.run(sutura.scene(held), console="/dev/nowhere")


@pytest.mark.skipif(sys.platform == "win32", reason="has no pseudoterminals")
@pytest.mark.parametrize("call", ["Console(port)", "run(scene, console=port, seconds=1)"])
def test_ctrl_c_ends_the_wait_for_a_console_that_says_nothing(call):
    # In a process of its own: the signal is of the whole process. Its handler runs where the wait looks for it.
    script = f"""
import os, pty, signal, threading, tty, sutura
ours, theirs = pty.openpty()
tty.setraw(ours)
tty.setraw(theirs)
port = os.ttyname(theirs)
scene = sutura.scene({{
    "device": "cartesian-bench",
    "mesh": {{"slab": {{"size_m": [0.02, 0.02, 0.01], "divisions": [2, 2, 1]}}}},
    "tissue": {{"youngs_modulus_pa": 15e3, "poisson_ratio": 0.45}},
    "fixed": [{{"plane": {{"axis": "z", "at_m": -0.01}}}}],
    "tool": [{{"radius_m": 0.01}}],
    "hand": {{"stiffness_n_per_m": 700.0, "damping_n_s_per_m": 10.0, "way_point": [{{"time_s": 0.0, "position_m": [0.0, 0.0, 0.03]}}]}},
}})
signal.signal(signal.SIGINT, signal.default_int_handler)

def asked():
    # Something has come: somebody waits for an answer.
    os.read(ours, 1)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=asked, daemon=True).start()
try:
    sutura.{call}
except KeyboardInterrupt:
    print("interrupted")
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert ran.stdout.strip() == "interrupted", ran.stdout + ran.stderr
