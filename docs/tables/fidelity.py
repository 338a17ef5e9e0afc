#!/usr/bin/env python3
"""Writes the figures of a report into the tables of `docs/src/fidelity.md`.

    sutura fidelity --full --plot out && docs/tables/fidelity.py out/fidelity.json

Tables keep their place, heading and first column; what is in their other cells comes from the report.
"""

import json
import pathlib
import re
import sys

PAGE = pathlib.Path(__file__).parent.parent / "src" / "fidelity.md"


def pick(cases, **wanted):
    """The one case with these values; None if there is none."""
    plain = {"tangent_scale": 1.0, "loss": 0.0, "burst_ms": 0.0, "reordered": 0.0, "guards_off": []}
    if wanted.get("rendering") == "rows":
        plain["most_rows"] = 24
    wanted = plain | wanted
    found = [case for case in cases if all(case[key] == value for key, value in wanted.items())]
    # A budget of all rows changes nothing.
    found = [case for case in found if not case["case"].endswith("24-rows")] or found
    if len(found) > 1:
        raise SystemExit(f"{len(found)} cases with {wanted}: {[case['case'] for case in found]}")
    return found[0] if found else None


def number(value):
    """What is not finite, as what never comes, is null in JSON."""
    return "never" if value is None else f"{value:.3g}"


def three(case):
    return f"{case['rms_pct']:.2f} / {case['peak_pct']:.2f} / {case['step_pct']:.2f}" if case else ""


def two(case):
    return f"{case['rms_pct']:.2f} / {case['peak_pct']:.2f}" if case else ""


class Page:
    def __init__(self, report):
        self.cases = report["cases"]
        self.errors = [case for case in self.cases if case["question"] == "errors"]
        self.report = report
        self.lines = PAGE.read_text().splitlines()

    def table(self, heading):
        """Where the first table after the line that contains `heading` has its body; its columns' names."""
        at = next(i for i, line in enumerate(self.lines) if heading in line)
        head = next(i for i in range(at + 1, len(self.lines)) if self.lines[i].startswith("|"))
        end = head
        while end < len(self.lines) and self.lines[end].startswith("|"):
            end += 1
        names = [cell.strip() for cell in self.lines[head].strip("|").split("|")]
        return head + 2, end, names

    def fill(self, heading, row_of):
        """Replaces each row by what `row_of(cells, names)` makes of it."""
        first, end, names = self.table(heading)
        for i in range(first, end):
            cells = [cell.strip() for cell in self.lines[i].strip("|").split("|")]
            self.lines[i] = "| " + " | ".join(row_of(cells, names)) + " |"

    def replace(self, heading, rows):
        first, end, _ = self.table(heading)
        self.lines[first:end] = ["| " + " | ".join(row) + " |" for row in rows]

    def error_tables(self):
        for i, line in enumerate(self.lines):
            found = re.match(r"\*\*(\w+), (\w+)\*\*", line)
            if not found:
                continue
            scene, hand = found.groups()
            cell = lambda rendering, hz: pick(
                self.errors, scene=scene, hand=hand, grasp="rigid", rendering=rendering, host_hz=hz
            )
            largest = cell("rows", 30.0)["force_max_n"]
            full = cell("full", 1000.0)
            self.lines[i] = f"**{scene}, {hand}**, largest force {largest:.2f} N" + (
                f"; `full` {two(full)}" if full else ""
            )
            self.fill(self.lines[i], lambda cells, names: [cells[0]] + [
                three(cell(cells[0], float(name.split()[0]))) for name in names[1:]
            ])

    def punctures(self):
        def row(cells, _):
            case = pick(
                self.errors, scene="needle", hand=cells[0], grasp="rigid", rendering="rows", host_hz=float(cells[1].split()[0])
            )
            return cells[:2] + [
                str(case["punctures"]), f"{case['puncture_p95_ms']:.0f} ms", f"{case['puncture_max_ms']:.0f} ms"
            ]
        self.fill("When punctures are felt", row)

    def wrong_tangents(self):
        self.fill("### A wrong tangent", lambda cells, names: cells[:2] + [
            two(pick(self.errors, scene="point", hand=cells[0], grasp="rigid", rendering="tangent",
                     host_hz=float(cells[1].split()[0]), tangent_scale=float(name[1:])))
            for name in names[2:]
        ])
        self.fill("### Fewer rows", lambda cells, names: cells[:2] + [
            two(pick(self.errors, scene="palpation", hand=cells[0], grasp="rigid", rendering="rows",
                     host_hz=float(cells[1].split()[0]), most_rows=int(name)))
            for name in names[2:]
        ])

    def stiffness(self):
        found = [case for case in self.cases if case["question"] == "stability" and not case["guards_off"]]
        own = [case for case in found if case["device_damping_n_s_per_m"] == 0.5]

        def cell(case):
            return f"{case['k_max_n_per_m']:.0f} ({case['k_ratio']:.2f}), {case['force_ratio']:.2f}" if case else ""
        self.fill("`sutura fidelity --full --only stability`", lambda cells, names: cells[:2] + [
            cell(pick(own, rendering=cells[0], tangent_scale=float(cells[1][1:]), host_hz=float(name.split()[0])))
            for name in names[2:]
        ])
        self.fill("Over the damping of the console", lambda cells, names: cells[:1] + [
            f"{case['k_max_n_per_m']:.0f}" if case else ""
            for case in (
                pick(found, rendering=cells[0], host_hz=1000.0 if cells[0] == "full" else 30.0,
                     device_damping_n_s_per_m=float(name))
                for name in names[1:]
            )
        ])

    def bad_links(self):
        kinds = [{"loss": 0.2}, {"burst_ms": 50.0}, {"reordered": 0.2}]

        def row(cells, _):
            values = []
            for kind in kinds:
                case = pick(
                    self.errors, scene=cells[0], hand=cells[1], grasp=cells[2], rendering="rows", host_hz=60.0, **kind
                )
                values.append(f"{1e3 * case['energy_min_j']:.2f}, {case['rms_pct']:.2f}".replace("-0.00,", "0.00,"))
            return cells[:3] + values
        self.fill("## Bad links", row)

    def returns(self):
        aways = {"outage-100-ms": "100 ms", "outage-200-ms": "200 ms", "outage-300-ms": "300 ms",
                    "outage-500-ms": "500 ms", "armed-inside": "armed inside"}
        found = {}
        for case in (case for case in self.cases if case["question"] == "return"):
            away = next(word for name, word in aways.items() if case["case"].endswith(name))
            found.setdefault((case["scene"], case["grasp"], away), {})[case["host_hz"]] = case

        def row(key, hosts):
            both = [hosts[hz] for hz in (30.0, 60.0)]
            each = lambda cell: " / ".join(cell(case) for case in both)
            time = lambda case: "never" if case.get("time_to_90_ms") is None else f"{case['time_to_90_ms']:.0f}"
            part = lambda case: "" if case.get("time_of_allowed") is None else f"{case['time_of_allowed']:.2f}"
            figure = lambda name: each(lambda case: f"{case[name]:.2f}")
            return [
                *key, each(lambda case: f"{case['gone_force_n']:.2f} of {case['returning_n']:.2f}"), each(time), each(part),
                figure("rise_n_per_s"), figure("beyond_true_mj"), figure("handed_out_mj"), figure("past_rest_mm"),
            ]
        self.replace("`sutura fidelity --full --only return`", [row(key, hosts) for key, hosts in found.items()])

    def unguarded(self):
        both = {links["is_unguarded"]: links for links in self.report["bad_links"]}
        self.replace("How many of the bad links", [
            [name, str(both[off]["cases"]), str(both[off]["over"]), str(both[off]["failing"]), f"{both[off]['most_mj']:.2f} mJ",
             f"{both[off]['most_beyond_taken_mj']:.2f} mJ"]
            for name, off in [("all guards", False), ("tank and damping off", True)]
        ])

    def bars(self):
        bars = self.report["bars"]
        at = next(i for i, line in enumerate(self.lines) if re.match(r"`sutura fidelity --full`: \d+ of", line))
        count = len(bars) - sum(bar["open"] for bar in bars)
        self.lines[at] = f"`sutura fidelity --full`: {sum(bar['ok'] for bar in bars)} of {count} met, {len(bars) - count} open."
        self.replace("## Bars", [
            [bar["name"], number(bar["value"]), f"{bar['must_be']} {bar['bar']:g}", bar["worst"],
             "met" if bar["ok"] else "open" if bar["open"] else "**missed**"]
            for bar in bars
        ])

    def trials(self):
        def of(spread, key, digits=1):
            three = spread[key]
            return " / ".join(f"{three[part]:.{digits}f}" for part in ("median", "p95", "worst"))
        self.replace("`sutura fidelity --full --only trial`", [
            [f"{spread['scene']}, {spread['hand']}, {spread['host_hz']:.0f} Hz", spread["factor"], str(spread["runs"]),
             of(spread, "rms_pct", 2), of(spread, "beyond_pct"), f"{spread['dropouts_per_min']:.0f}",
             of(spread, "given_back_mj", 2)]
            for spread in self.report["spreads"]
        ])
        self.replace("What becomes of punctures", [
            [f"{spread['scene']}, {spread['hand']}, {spread['host_hz']:.0f} Hz", spread["factor"], str(spread["punctures"]),
             f"{spread['missed_pct']:.1f} %", f"{spread['stalled_pct']:.1f} %", of(spread, "fall_off_pct", 0),
             of(spread, "fall_late_ms", 0)]
            for spread in self.report["spreads"] if spread["punctures"] > 0 and spread["scene"] == "needle"
        ])

    def corners(self):
        corners = [case for case in self.cases if case["question"] == "corner"]
        hands = list(dict.fromkeys(case["grasp"] for case in corners))
        hands = [hand for hand in ["hand-50", "pen", "hand-800", "weight-10-g", "weight-100-g", "weight-0-g"] if hand in hands]
        devices = sorted({case["device"] for case in corners}, key=[
            "nominal", "+1-tick", "-1-tick", "lag-1-ms", "lag-2-ms", "mass-x0.5", "mass-x2", "torque-x0.8", "torque-x1.2"
        ].index)
        of = {(case["device"], case["grasp"]): case for case in corners}
        cell = lambda case: f"{case['k_max_n_per_m']:.0f} ({case['k_of_reference']:.2f})"
        self.replace("`sutura fidelity --full --only corner`", [
            [device] + [cell(of[device, hand]) for hand in hands] for device in devices
        ])

    def baselines(self):
        guarded = lambda rendering, hz, off: pick(
            self.errors, scene="palpation", hand="presses", grasp="rigid", rendering=rendering, host_hz=hz, guards_off=off
        )
        self.fill("What others are measured by", lambda cells, names: cells[:2] + [
            three(guarded(cells[0], float(name.split()[0]), [] if cells[1] == "with" else ["tank", "damping"]))
            for name in names[2:]
        ])

    def guards(self):
        with_all = {bar["name"]: bar["value"] for bar in self.report["bars"]}
        fails = {mutant["guard"]: mutant["fails"] for mutant in self.report["guards"]}

        def beyond(bar):
            if bar["value"] is None or bar["bar"] == 0.0:
                return float("inf")
            ratio = abs(bar["value"] / bar["bar"])
            return ratio if bar["must_be"] == "<=" else 1.0 / max(ratio, 1e-9)

        first, end, _ = self.table("## What each guard is for")
        rows = []
        for line in self.lines[first:end]:
            guard, bounds, told = [cell.strip() for cell in line.strip("|").split("|")][:3]
            # The bar that the page names, as long as it fails; else the worst.
            bar = next((bar for bar in fails[guard] if bar["name"] == told), None) or max(fails[guard], key=beyond, default=None)
            if bar is None:
                rows.append([guard, bounds, "none", "", "", ""])
                continue
            rows.append([
                guard, bounds, bar["name"], f"{bar['must_be']} {bar['bar']:g}",
                number(with_all[bar["name"]]) if bar["name"] in with_all else "", number(bar["value"]),
            ])
        self.replace("## What each guard is for", rows)


def main():
    page = Page(json.loads(pathlib.Path(sys.argv[1]).read_text()))
    for part in (page.error_tables, page.punctures, page.wrong_tangents, page.stiffness, page.bad_links, page.unguarded, page.returns, page.trials, page.corners, page.baselines, page.bars, page.guards):
        part()
    PAGE.write_text("\n".join(page.lines) + "\n")


if __name__ == "__main__":
    main()
