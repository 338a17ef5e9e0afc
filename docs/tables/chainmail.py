#!/usr/bin/env python3
"""Writes curves into the tables of `docs/src/chainmail.md`.

    cargo run --release -p sutura-models --example chainmail_curves | docs/tables/chainmail.py

A table that follows `NAME` in backquotes gets the series of that name: forces in mN, the first column as it is.
"""

import pathlib
import sys

PAGE = pathlib.Path(__file__).parent.parent / "src" / "chainmail.md"
NAMES = ["depth", "printed", "loop", "relaxation"]


def series(lines):
    """Rows of cells by name, without the line of column names."""
    found, name = {}, None
    for line in lines:
        line = line.strip()
        if line.startswith("# "):
            name = line[2:]
            found[name] = []
        elif name and not line[0].isalpha():
            found[name].append(line.split(","))
    return found


def cell(force_n):
    force_mn = 1e3 * float(force_n)
    return f"{force_mn:,.0f}" if abs(force_mn) >= 1000 else f"{force_mn:.2f}"


def main():
    found = series(sys.stdin)
    lines = PAGE.read_text().splitlines()
    for name in NAMES:
        if name not in found:
            continue
        at = next(i for i, line in enumerate(lines) if line.startswith(f"`{name}`:"))
        head = next(i for i in range(at, len(lines)) if lines[i].startswith("|"))
        end = head
        while end < len(lines) and lines[end].startswith("|"):
            end += 1
        rows = ["| " + " | ".join([row[0], *map(cell, row[1:])]) + " |" for row in found[name]]
        lines[head + 2 : end] = rows
    PAGE.write_text("\n".join(lines) + "\n")


main()
