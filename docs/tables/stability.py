#!/usr/bin/env python3
"""Writes a report's tables into `docs/src/stability.md`.

    sutura stability --full --plot out && docs/tables/stability.py out
"""

import json
import pathlib
import sys

from marked import short, table, write

WORDS = {"stable": "yes", "degraded": "*degraded*", "refused": "**refused**", "defect": "**DEFECT**"}


def matrix(cases):
    tissues = list(dict.fromkeys(case["tissue"] for case in cases))
    found = {(case["tissue"], case["what"], case["value"]): case["outcome"] for case in cases}
    rows = dict.fromkeys((case["what"], case["value"]) for case in cases)
    return table(
        ["what", "value"] + [tissue.replace("energy-balance", "EB").replace("chainmail", "CM") for tissue in tissues],
        [
            [what, short(value, 6)] + [WORDS.get(found.get((tissue, what, value)), "") for tissue in tissues]
            for what, value in rows
        ],
    )


def notes(cases):
    return table(
        ["tissue", "what", "value", "outcome", "how, or why"],
        [
            [case["tissue"], case["what"], short(case["value"], 6), case["outcome"], case["note"]]
            for case in cases
            if case["outcome"] != "stable"
        ],
    )


def largest(cases):
    return table(
        ["tissue", "largest stable step \\[s\\]"],
        [
            [case["tissue"], "at least 10" if case["largest_stable"] >= 10 else short(case["largest_stable"])]
            for case in cases
            if case["largest_stable"] is not None
        ],
    )


def count(cases):
    of = lambda outcome: sum(case["outcome"] == outcome for case in cases)
    return [
        f"{len(cases)} cases: {of('stable')} stable, {of('degraded')} degraded, {of('refused')} refused,"
        f" {of('defect')} defects."
    ]


def main():
    cases = json.loads((pathlib.Path(sys.argv[1]) / "stability.json").read_text())["cases"]
    models = [case for case in cases if case["tissue"] != "rows" and not case["tissue"].startswith("console")]
    others = [case for case in cases if case not in models]
    write("stability.md", {
        "count": count(cases), "models": matrix(models), "others": matrix(others), "largest": largest(cases),
        "notes": notes(cases),
    })


if __name__ == "__main__":
    main()
