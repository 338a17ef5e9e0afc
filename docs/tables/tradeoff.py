#!/usr/bin/env python3
"""Writes a report's tables into the book; its pictures: `cargo xtask plots`.

    sutura tradeoff --full --plot out && docs/tables/tradeoff.py out && cargo xtask plots --from out/tradeoff.json --sheet
"""

import json
import pathlib
import statistics
import sys

from marked import short, table, write

BUDGETS_MS = [0.5, 1.0, 5.0, 30.0]


def what(row):
    name = row["tissue"].replace("energy-balance", "EB").replace("chainmail", "CM")
    settings = f", {row['settings']}" if row["settings"] else ""
    return f"{name}{settings}"


def truths(report):
    return table(
        ["case", "nodes", "moves by", "force by", "mean displacement \\[mm\\]"],
        [
            [f"`{t['case']}`", f"{t['nodes']:,}", short(t["change_pct"]) + " %", short(t["force_change_pct"]) + " %",
             short(1e3 * t["mean_m"], 4)]
            for t in report["truths"]
        ],
    )


def best(report):
    rows = []
    for truth in report["truths"]:
        cells = [f"`{truth['case']}`"]
        for budget in BUDGETS_MS:
            found = next(b for b in report["best"] if b["case"] == truth["case"] and b["budget_ms"] == budget)
            if not found["tissue"]:
                cells.append("nothing")
                continue
            force = short(found["truth_force_pct"])
            cells.append(
                f"**{short(found['error_pct'])} %** (moving {short(found['arrival_rms_pct'])}, at rest"
                f" {short(found['truth_disp_rms_pct'])}, line {short(found['truth_red_line_pct'])}, force {force}):"
                f" {what(found)}; {found['cells']:,} cells"
            )
        rows.append(cells)
    return table(["case"] + [f"{budget:g} ms" for budget in BUDGETS_MS], rows)


def fronts(report):
    lines = []
    for truth in report["truths"]:
        front = [row for row in report["cases"] if row["case"] == truth["case"] and row["pareto"]]
        front.sort(key=lambda row: row["step_us"])
        lines += [f"**`{truth['case']}`**: {truth['about']}", "", f"![](tradeoff/tradeoff-{truth['case']}.svg)", ""]
        lines += table(
            ["no.", "model", "cells", "us a step", "+- %", "error %", "moving", "at rest", "line", "force", "same mesh"],
            [
                [str(number), what(row), f"{row['cells']:,}", short(row["step_us"], 3), short(row["spread_pct"], 1),
                 short(row["error_pct"]), short(row["arrival_rms_pct"]), short(row["truth_disp_rms_pct"]),
                 short(row["truth_red_line_pct"]),
                 short(row["truth_force_pct"]), short(row["disp_rms_pct"])]
                for number, row in enumerate(front, 1)
            ],
        )
        lines.append("")
    return lines[:-1]


def printed(report):
    """The thesis's errors beside ours, as the thesis takes them: on the line, against the same cells."""
    rows = []
    for figure in report["literature"]:
        if not figure["case"] or "energy balance" not in figure["source"]:
            continue
        iterations = "100" if "100" in figure["what"] else "20"
        own = [
            row for row in report["cases"]
            if row["case"] == figure["case"] and row["tissue"] == "energy-balance-neo-hookean"
            and row["settings"].endswith(f", {iterations} iterations")
        ]
        # The finest on which all forms were measured.
        finest = max(row["level"] for row in own if "compliant" in row["settings"] or iterations == "100")
        of = {row["settings"].split(",")[0]: row for row in own if row["level"] == finest}
        cell = lambda form: (
            "-" if form not in of
            else (of[form]["outcome"] if of[form]["red_line_pct"] is None else short(of[form]["red_line_pct"]))
        )
        rows.append(
            [f"`{figure['case']}`", iterations, f"{figure['value']:g}"]
            + [cell(form) for form in ("printed", "averaged", "compliant", "balanced")]
            + [f"{of['balanced']['cells']:,}"]
        )
    return table(
        ["case", "iterations a step", "thesis", "printed", "averaged", "compliant", "balanced", "cells"], rows
    )


def literature(report):
    return table(
        ["source", "what", "figure"],
        [[f["source"], f["what"], f"{f['value']:g} {f['unit']}"] for f in report["literature"] if not f["case"]],
    )


def sutures(report):
    rows = report["sutures"]
    return table(
        ["tissue", "nodes", "cells", "gap", "tension \\[N\\]", "gap off", "tension off", "p50 \\[ms\\]", "p99 \\[ms\\]"],
        [
            [row["tissue"], f"{row['nodes']:,}", f"{row['cells']:,}", short(row["gap_ratio"], 3), short(row["tension_n"], 3)]
            + [short(row[key], 2) + (" %" if row[key] is not None else "") for key in ("gap_off_pct", "tension_off_pct")]
            + [short(1e-3 * row[key], 2) for key in ("step_us", "p99_us")]
            for row in rows
        ],
    )


def noise(report):
    spreads = sorted(row["spread_pct"] for row in report["cases"] if row["runs"] >= 3)
    tenth = spreads[len(spreads) * 9 // 10]
    return [
        f"{len(report['cases'])} lines; medians of up to five runs lie {short(statistics.median(spreads))} % apart in"
        f" the median and {short(tenth)} % at the ninetieth hundredth."
    ]


def main():
    directory = pathlib.Path(sys.argv[1])
    report = json.loads((directory / "tradeoff.json").read_text())
    write("tradeoff.md", {
        "truths": truths(report), "best": best(report), "fronts": fronts(report), "printed": printed(report),
        "noise": noise(report), "sutures": sutures(report), "literature": literature(report),
    })


if __name__ == "__main__":
    main()
