#!/usr/bin/env python3
"""A host of one page: `press.py PORT [SECONDS]` renders a plane of springs under a simulated console's hand.

Shows how a simulation talks to a console: handshake, arm, then a contact for the newest state. JSON when done.
"""

import json
import sys
import time

from sutura_peer import Host

PLANE_N_PER_M = 300.0
# The hand comes from 10 mm above the plane z = 0 and wants to be 10 mm below it.
HAND = {
    "stiffness_n_per_m": 1000.0, "damping_n_s_per_m": 10.0, "start_joint": [0.0, 0.0, 0.01], "count": 2,
    "way_points": [{"time_s": 0.4 * min(k, 1), "position_m": [0.0, 0.0, -0.01 if k else 0.01]} for k in range(12)],
}


def contact(state):
    """The plane as it is near the pose of a state."""
    z = state["position_m"][2]
    return {
        "tool": 0, "position_m": state["position_m"], "orientation": state["orientation"],
        "wrench": [0.0, 0.0, PLANE_N_PER_M * max(-z, 0.0), 0.0, 0.0, 0.0],
        # Upper triangle by rows: entry 11 is d Fz / d z.
        "tangent": [-PLANE_N_PER_M if k == 11 else 0.0 for k in range(21)],
        "gap_m": max(z, 0.0), "normal": [0.0, 0.0, 1.0], "relaxation_per_s": 0.0, "horizon_us": 100_000,
    }


def press(path, seconds):
    host = Host(path)
    seen = {"console": host.open(), "states": 0, "contacts": 0, "pongs": 0, "peak_n": 0.0, "modes": []}
    host.send("Simulate", {"Hand": HAND})
    host.send("Command", "Arm")
    until, contact_due = time.monotonic() + seconds, 0.0
    while time.monotonic() < until:
        newest = None
        for name, body, _ in host.frames(0.05):
            if name == "State":
                newest = seen["state"] = body
                seen["states"] += 1
                seen["peak_n"] = max(seen["peak_n"], body["force_n"][2])
                if body["mode"] not in seen["modes"]:
                    seen["modes"].append(body["mode"])
            seen["pongs"] += name == "Pong"
        if newest and time.monotonic() >= contact_due:
            host.send("Contact", contact(newest))
            seen["contacts"] += 1
            contact_due = time.monotonic() + 0.01
    host.close()
    return {**seen, "lost": host.lost, "refused": host.refused}


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    try:
        print(json.dumps(press(sys.argv[1], float(sys.argv[2]) if sys.argv[2:] else 3.0)))
    except OSError as error:
        sys.exit(f"press.py: {error}")
