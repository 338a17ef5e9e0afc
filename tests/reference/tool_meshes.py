"""Closed surfaces for tests of tools that are meshes, in millimetres: an L of two bars as ASCII STL, a ring as binary STL.

Usage: python3 tests/reference/tool_meshes.py tests/data
Nothing but Python 3; the files come out the same on every machine.
"""

import math
import struct
import sys
from pathlib import Path

# The L in the plane x, z, counter-clockwise as seen from -y: a foot of 40 x 12, a leg of 12 up to 36; both 16 wide.
BRACKET = [(-20, 0), (20, 0), (20, 12), (-8, 12), (-8, 36), (-20, 36)]
# Its cap in triangles, by corners of that list.
CAP = [(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)]
WIDTH = 16

# A ring around z: radius of its middle line, of its section, and how many corners both have.
RING = (16.0, 6.0, 16, 8)


def bracket():
    half = WIDTH / 2
    near = [(x, -half, z) for x, z in BRACKET]
    far = [(x, half, z) for x, z in BRACKET]
    triangles = [tuple(near[i] for i in cap) for cap in CAP]
    triangles += [tuple(far[i] for i in reversed(cap)) for cap in CAP]
    for i in range(len(BRACKET)):
        j = (i + 1) % len(BRACKET)
        triangles += [(near[i], far[i], far[j]), (near[i], far[j], near[j])]
    return triangles


def ring():
    middle, section, around, across = RING

    def corner(i, j):
        along, about = 2 * math.pi * i / around, 2 * math.pi * j / across
        out = middle + section * math.cos(about)
        return (out * math.cos(along), out * math.sin(along), section * math.sin(about))

    # What rounding has made of the same corner must be the same.
    corners = [[corner(i, j) for j in range(across)] for i in range(around)]
    at = lambda i, j: corners[i % around][j % across]
    triangles = []
    for i in range(around):
        for j in range(across):
            a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
            triangles += [(a, b, c), (a, c, d)]
    return triangles


def ascii_stl(name, triangles):
    lines = [f"solid {name}"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(f"{x:g}" for x in corner) for corner in triangle]
        lines += ["endloop", "endfacet"]
    return "\n".join(lines + [f"endsolid {name}", ""]).encode()


def binary_stl(name, triangles):
    # As many programs write it, with a title that begins like an ASCII file's.
    parts = [f"solid {name}".encode().ljust(80), struct.pack("<I", len(triangles))]
    for triangle in triangles:
        numbers = [0.0, 0.0, 0.0] + [x for corner in triangle for x in corner]
        parts.append(struct.pack("<12fH", *numbers, 0))
    return b"".join(parts)


def main():
    folder = Path(sys.argv[1])
    (folder / "bracket.stl").write_bytes(ascii_stl("bracket", bracket()))
    (folder / "ring.stl").write_bytes(binary_stl("ring", ring()))


main()
