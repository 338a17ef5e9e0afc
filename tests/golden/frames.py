#!/usr/bin/env python3
"""Writes frames.hex: one whole frame of every message, by the host in Python (hil/python/sutura_peer.py).

That host shares nothing with the Rust code: it is written from the protocol's description alone. Run this only when the
protocol changes: `python3 tests/golden/frames.py > tests/golden/frames.hex`.
"""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "hil" / "python"))

from sutura_peer import encode  # noqa: E402

hello_host = {
    "schema_hash": 0x0123456789ABCDEF, "nonce": 0xDEADBEEF, "session": 0, "tick_hz": 1000, "max_frame": 300,
    "simulated": False, "device_name": "", "refusal": "None",
}
hello_console = {**hello_host, "session": 0xC0FFEE, "simulated": True, "device_name": "desk"}
hello_owned = {**hello_console, "session": 0, "refusal": "Owned"}
state = {
    "tick": 123456,
    "position_m": [0.125, -0.25, 0.5],
    "orientation": [0.0, 0.0, 0.0, 1.0],
    "velocity_m_per_s": [1.5, -0.0, -2.0],
    "force_n": [0.75, 0.0, -3.5],
    "current_a": [0.25, -0.25, 1.0],
    "mode": "Decaying",
    "faults": 0b10001,  # emergency stop, board
    "contact_sequence": 77,
    "contact_age_us": 33000,
    "applied_age_us": 0xFFFFFFFF,
    "trace_hash": 0xFEDCBA9876543210,
    "encoder_counts": [300, -2, -(2**31)],
    "inputs": 0b1000_1001,  # emergency stop, orientation, force withheld
    "heard_sequence": 70000,
}
contact = {
    "tool": 0,
    "position_m": [0.125, -0.25, 0.5],
    "orientation": [0.5, -0.5, 0.5, 0.5],
    "wrench": [0.0, 1.0, -2.0, 0.5, 0.25, -0.125],
    "tangent": [-8.0 * (k + 1) for k in range(21)],
    "gap_m": 0.0,
    "normal": [0.0, 0.0, 1.0],
    "relaxation_per_s": 0.5,
    "horizon_us": 100000,
}
needle = {
    "tool": 0,
    "needle": 3,
    "slide": [0.0, 0.75, -2.0, 125.0, 0.0, -0.0],
    "tip": "Holding",
    "friction": "Backward",
    "axial_n": -0.375,
    "friction_n": [0.5, 0.25],
    "stiffness_n_per_m": [256.0, 64.0],
    "hold_n": 0.0625,
    "puncture_n": 0.125,
    "punctured_n": -0.3125,
    "course": {
        "forward": 3,
        "backward": 1,
        "points": [[0.0009765625, -0.5], [0.0009765625, -0.3125], [0.001953125, -0.34375], [0.0001220703125, 0.25]]
        + [[0.0, 0.0]] * 8,
    },
}
thread = {
    "tool": 0,
    "thread": 2,
    "end": "Head",
    "state": "Taut",
    "direction": [0.0, -1.0, -0.0],
    "tension_n": 1.5,
    "stiffness_n_per_m": 512.0,
    "slack_m": 0.0,
}


def row(kind, k, force):
    jacobian = [0.0, -0.5 * k, -1.0, 0.125, k, -0.0]
    return {"kind": kind, "delta_free_m": -0.25 * k, "lambda_n": force, "jacobian": jacobian}


rows = {
    "tool": 0,
    "held": [8.0 * (k + 1) for k in range(21)],
    "curvature_per_m": 125.0,
    "rows": [
        row({"Smooth": {"id": 3}}, 1, 0.75),
        row({"Normal": {"id": 70000, "friction": 0.5}}, 2, 2.0),
        row({"Tangent": {"anchor_m": -0.125}}, 3, -0.5),
        row({"Tangent": {"anchor_m": 0.0}}, 4, 0.0),
    ],
    "compliance": [0.5, 0.25, -0.125, 0.0, 0.5, 0.0625, -0.0, 1.0, 0.03125, 2.0],
}
report = {
    "ticks": 100000, "tick_overruns": 1, "ticks_late": 2, "frames_received": 30000, "frames_lost": 4,
    "frames_rejected": 5, "frames_superseded": 300,
    "last_reject": 4,  # checksum
    "reset_cause": 1,  # power
    "epitaph_kind": 2,  # hard fault
    "epitaph_place": 0x08001234, "stack_free_bytes": 4096, "tick_cost_max": 2400,
}


def joint(k):
    return {
        "counts_per_unit": 1000.0 * k, "zero_counts": -k, "effort_per_amp": 0.25 * k, "max_current_a": 2.5,
        "max_slew_per_s": 400.0, "max_speed_per_s": 3.0, "inertia": 0.125 * k, "damping": 0.5, "coulomb": 0.0625,
    }


def device(kinematics):
    return {"Device": {
        "name": "bras é", "kinematics": kinematics, "joints": [joint(1), joint(2), joint(3)],
        "gravity_mass_kg": [0.0, 0.5, 0.25], "max_force_n": 12.0, "max_power_w": 6.0, "max_grip_speed_m_per_s": 1.5,
        "actuation_delay_us": 1000,
    }}


cartesian = {"Cartesian": {"origin_m": [-1.0, 0.0, 0.5]}}
serial_arm = {"SerialArm": {"shoulder_m": [0.0, 0.0, 0.25], "upper_m": 0.125, "fore_m": 0.25}}
path = [{"time_s": 0.5 * k, "position_m": [0.25, 0.0, -0.125 * k]} for k in range(3)]
hand = {"Hand": {
    "stiffness_n_per_m": 200.0, "damping_n_s_per_m": 2.0, "start_joint": [0.0, 0.5, -0.5], "count": 3,
    "way_points": path + [{"time_s": 0.0, "position_m": [0.0, 0.0, 0.0]}] * 9,
}}
wall = {"Wall": {
    "point_m": [0.0, 0.0, -0.125], "normal": [0.0, 0.0, 1.0], "stiffness_n_per_m": 800.0, "damping_n_s_per_m": 2.0,
}}
coupling = {"Coupling": {"anchor_m": [0.25, -0.5, 0.0], "stiffness_n_per_m": 400.0, "damping_n_s_per_m": 1.5}}
offset = {"EncoderOffset": [-1, 2**31 - 1, -(2**31)]}

SESSION = 0xC0FFEE
# Name, message, body, session, sequence, console time.
FRAMES = [
    ("hello_host", "Hello", hello_host, 0, 0, 0),
    ("hello_console", "Hello", hello_console, 0, 0, 5_000_000_000),
    ("state", "State", state, SESSION, 1, 123_456_000),
    ("contact", "Contact", contact, SESSION, 2, 123_423_000),
    ("needle", "Needle", needle, SESSION, 12, 123_423_000),
    ("thread", "Thread", thread, SESSION, 13, 123_423_000),
    ("rows", "Rows", rows, SESSION, 14, 123_423_000),
    ("fixture_none", "Fixture", "None", SESSION, 15, 0),
    ("fixture_wall", "Fixture", wall, SESSION, 16, 0),
    ("fixture_coupling", "Fixture", coupling, SESSION, 17, 0),
    ("ping", "Ping", {"host_us": 5_000_000_000}, SESSION, 18, 123_423_000),
    ("pong", "Pong", {"host_us": 5_000_000_000, "received_us": 123_456_100, "sent_us": 123_457_000}, SESSION, 2,
     123_457_000),
    ("hello_owned", "Hello", hello_owned, 0, 0, 5_000_000_000),
    ("command_arm", "Command", "Arm", SESSION, 3, 0),
    ("command_disarm", "Command", "Disarm", SESSION, 4, 0),
    ("command_clear_fault", "Command", "ClearFault", SESSION, 5, 0),
    ("command_state_every", "Command", {"StateEvery": {"ticks": 1000}}, SESSION, 6, 0),
    ("report", "Report", report, SESSION, 0xFFFFFFFF, 2**63),
    ("simulate_device_cartesian", "Simulate", device(cartesian), SESSION, 7, 0),
    ("simulate_device_serial_arm", "Simulate", device(serial_arm), SESSION, 8, 0),
    ("simulate_hand", "Simulate", hand, SESSION, 9, 0),
    ("simulate_emergency_stop", "Simulate", {"EmergencyStop": True}, SESSION, 10, 0),
    ("simulate_encoder_offset", "Simulate", offset, SESSION, 11, 0),
]

print("# Whole frames of protocol version 1, by frames.py: name, bytes in hex.")
for name, message, body, session, sequence, console_time_us in FRAMES:
    print(name, encode(message, body, session, sequence, console_time_us).hex())
