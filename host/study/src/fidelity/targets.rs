//! Bars on what trials and corners show. Some are missed by the console as it is: those are kept here, by name and with the
//! worst figure that is known, are told as open, and fail nothing unless they get worse.
//!
//! Entry points: [`bars`], [`is_open`], [`tighten`].

use super::bars::Bar;
use super::case::Case;
use super::corners::{self, Line};
use super::returns::{self, Returned};
use super::trials::{SEEDS, Spread, spreads};
use schemars::JsonSchema;
use serde::Serialize;

/// Bars that are open, and the worst that is known of them, in the short form or in the full one.
const OPEN: &[(&str, f64)] = &[
    // 15 Hz and a fifth of the frames lost; 20.1 with the code of 1e64281 on the same tissue.
    ("gristle strokes, pen hand, slow host, rms %", 21.6),
    // Tools that rub: a line has room for 24 rows where twenty vertices touch, and frames of 30 Hz foretell a hand that turns by 5 mm.
    ("rubbing taps rows 60 Hz peak %", 7.29),
    ("rubbing strokes rows 60 Hz rms %", 2.45),
    ("rubbing strokes rows 60 Hz peak %", 10.72),
    ("rubbing strokes rows 60 Hz slip p95 ms", 8.0),
    ("rubbing strokes rows 30 Hz rms %", 7.33),
    ("rubbing strokes rows 30 Hz slip p95 ms", 41.0),
    // A cone's rows do not turn with the body.
    ("round body of 8 mm, tool that rubs, rms %", 5.81),
    // The same hand without a frame for 33 to 110 ms, in which it turns.
    ("stalls, tools that rub, contact beyond notice %", 4.93),
    ("stalls, tools that rub, rms p95 %", 11.2),
    ("stalls, tools that rub, rms worst %", 11.2),
    // A console that is a tick quicker than described, held by a pen: it swings by an encoder's step or two, a little more from half a
    // second to the next. Of the others the worst is 0.87.
    ("stiffness 30 Hz, corners, of their own references", 0.469),
    ("stiffness 30 Hz, corners, of what it was", 0.516),
    // Motors a fifth stronger than described give back a fifth more than the tissue, whatever a console does.
    ("given back in 100 ms, corners, mJ", 2.06),
];

/// Whether a missed bar is known to be, and not missed by more than that.
pub fn is_open(name: &str, at_least: bool, value: f64) -> bool {
    let is_no_worse = |known: f64| {
        if at_least {
            value >= known
        } else {
            value <= known
        }
    };
    OPEN.iter()
        .any(|(open, known)| *open == name && is_no_worse(*known))
}

/// Part of what is known of an open bar by which a run is better where that is to be told.
const BETTER: f64 = 0.05;

/// An open bar that was better in a run than it is known to be.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Tighten {
    /// Of the bar.
    pub name: String,
    /// In that run.
    pub value: f64,
    /// The worst that is known.
    pub known: f64,
    /// The bound.
    pub bar: f64,
    /// Whether that is met.
    pub met: bool,
}

/// The open bars that are better in these than they are known to be, by more than a twentieth of that. What is known may be of
/// cases that the run has not.
pub fn tighten(bars: &[Bar]) -> Vec<Tighten> {
    let better = |bar: &Bar| {
        let (_, known) = OPEN.iter().find(|(name, _)| *name == bar.name)?;
        let gained = if bar.must_be == ">=" {
            bar.value - known
        } else {
            known - bar.value
        };
        (gained > BETTER * known.abs()).then(|| Tighten {
            name: bar.name.clone(),
            value: bar.value,
            known: *known,
            bar: bar.bar,
            met: bar.ok,
        })
    };
    bars.iter().filter_map(better).collect()
}

/// Most that may be given back in 100 ms beyond the true tissue \[mJ\].
pub const GIVEN_BACK_MJ: f64 = 2.0;

/// Stalls that a host's first horizon is long enough for \[ms\].
const SHORT_MS: f64 = 80.0;

/// Most that may be given to the hand by a force that comes back \[mJ\].
const GIVEN_MJ: f64 = 15.0;
/// Farthest that such a force may throw a hand past where it rests \[mm\].
const PAST_MM: f64 = 2.0;
/// Least that motors may have taken, less what they had given \[mJ\].
pub const LEAST_ENERGY_MJ: f64 = -1.0;

/// The corners as they were before anything was done about them: `sutura fidelity --full --only corner --plot DIR`.
const BEFORE: &str = include_str!("corners-before.csv");

/// Largest stable stiffness of a corner before \[N/m\].
fn before(device: &str, hand: &str) -> Option<f64> {
    let lines = BEFORE.lines().filter(|line| !line.starts_with('#'));
    let mut lines = lines.map(|line| line.split(',').collect::<Vec<_>>());
    let head = lines.next()?;
    let column = |name: &str| head.iter().position(|word| *word == name);
    let (of_device, of_hand, k) = (column("device")?, column("hand")?, column("k_max_n_per_m")?);
    let line =
        lines.find(|l| l.get(of_device) == Some(&device) && l.get(of_hand) == Some(&hand))?;
    line.get(k)?.parse().ok()
}

/// A figure of something with a name: the worst one counts.
struct Bound<'a> {
    name: &'a str,
    at_least: bool,
    bar: f64,
}

impl Bound<'_> {
    fn judge(&self, figures: impl Iterator<Item = (f64, String)>) -> Option<Bar> {
        let sign = if self.at_least { -1.0 } else { 1.0 };
        let (value, worst) = figures.max_by(|a, b| (sign * a.0).total_cmp(&(sign * b.0)))?;
        let ok = sign * value <= sign * self.bar;
        Some(Bar {
            name: self.name.to_owned(),
            value,
            must_be: if self.at_least { ">=" } else { "<=" },
            bar: self.bar,
            ok,
            open: !ok && is_open(self.name, self.at_least, value),
            worst,
        })
    }
}

/// What trials and corners must be.
pub fn bars(cases: &[Case]) -> Vec<Bar> {
    let spreads = spreads(cases);
    let mut bars = of_spreads(&spreads);
    let lossy = cases
        .iter()
        .filter(|case| is_on_bad_link(case) && !case.is_unguarded());
    bars.extend(given_back_on_bad_links(lossy));
    // Longer than these no horizon of a host of 60 Hz that knows nothing is.
    let short = |case: &&Case| {
        let trial = case.trial.as_ref();
        trial.is_some_and(|trial| trial.factor == "stalls" && trial.longest_stall_ms <= SHORT_MS)
            && case.scene == "palpation"
            && case.hand != "taps"
    };
    let dropouts = Bound {
        name: "first stalls of up to 80 ms, dropouts a minute",
        at_least: false,
        bar: 0.0,
    };
    let stalled = cases.iter().filter(short);
    bars.extend(dropouts.judge(stalled.map(|case| {
        let dropouts = case.noticed.map_or(f64::INFINITY, |n| n.dropouts_per_min);
        (dropouts, case.case.clone())
    })));
    bars.extend(of_corners(&corners::table(cases)));
    bars.extend(of_returns(cases));
    bars
}

/// A figure of a force that has come back.
type Figure = fn(&Returned) -> f64;

/// What forces that come back must be, on each tissue.
const RETURNS: [(&str, f64, Figure); 6] = [
    ("90 % of the force, of the time allowed", 1.0, |r| {
        r.time_of_allowed.unwrap_or(f64::INFINITY)
    }),
    ("rise N/s", returns::RISE_N_PER_S, |r| r.rise_n_per_s),
    ("given beyond the true tissue mJ", GIVEN_MJ, |r| {
        r.beyond_true_mj
    }),
    ("given at all mJ", GIVEN_MJ, |r| r.handed_out_mj),
    ("hand past its rest mm", PAST_MM, |r| r.past_rest_mm),
    ("given back in 100 ms else, mJ", GIVEN_BACK_MJ, |r| {
        r.given_back_else_mj
    }),
];

fn of_returns(cases: &[Case]) -> Vec<Bar> {
    let mut bars = Vec::new();
    for scene in ["palpation", "point"] {
        for (what, bar, figure) in RETURNS {
            let bound = Bound {
                name: &format!("return {scene}: {what}"),
                at_least: false,
                bar,
            };
            let own = cases.iter().filter(|case| case.scene == scene);
            let of = own.filter_map(|case| Some((figure(case.returned.as_ref()?), case)));
            bars.extend(bound.judge(of.map(|(value, case)| (value, case.case.clone()))));
        }
    }
    // Longer than any horizon and its decay.
    let gone = Bound {
        name: "force N at the end of an outage",
        at_least: false,
        bar: 0.0,
    };
    let long = cases.iter().filter(|case| case.burst_ms >= 200.0);
    let left = long.filter_map(|case| Some((case.returned.as_ref()?.gone_force_n, case)));
    bars.extend(gone.judge(left.map(|(value, case)| (value, case.case.clone()))));
    bars
}

/// Whether it is one of the cases of links that lose, stop and reorder, on hosts that are fast enough.
pub fn is_on_bad_link(case: &Case) -> bool {
    case.question == "errors" && case.is_lossy() && case.scene != "gristle"
}

fn given_back_on_bad_links<'a>(cases: impl Iterator<Item = &'a Case>) -> Option<Bar> {
    let bound = Bound {
        name: "given back in 100 ms, bad links, mJ",
        at_least: false,
        bar: GIVEN_BACK_MJ,
    };
    bound.judge(cases.map(|case| {
        (
            case.given_back_mj.unwrap_or(f64::INFINITY),
            case.case.clone(),
        )
    }))
}

/// What bad links give back, with all guards or without tank and damping.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct BadLinks {
    /// Without tank and damping.
    pub is_unguarded: bool,
    /// How many cases there are.
    pub cases: usize,
    /// In how many more than [`GIVEN_BACK_MJ`] is given back: in 100 ms beyond the true tissue, or beyond all that had been
    /// taken.
    pub over: usize,
    /// In how many of these a bar on energy fails: all, or they are not worth their name.
    pub failing: usize,
    /// The most that is given back in 100 ms beyond the true tissue \[mJ\].
    pub most_mj: f64,
    /// The most that is given beyond all that had been taken \[mJ\].
    pub most_beyond_taken_mj: f64,
}

/// Of both, where there are cases.
pub fn bad_links(cases: &[Case]) -> Vec<BadLinks> {
    let of = |is_unguarded: bool| {
        let own: Vec<_> = cases
            .iter()
            .filter(|case| is_on_bad_link(case) && case.is_unguarded() == is_unguarded)
            .collect();
        let mj = |case: &Case| case.given_back_mj.unwrap_or(0.0);
        let beyond_mj = |case: &Case| (-1e3 * case.energy_min_j).max(0.0);
        let is_over = |case: &&Case| mj(case).max(beyond_mj(case)) > GIVEN_BACK_MJ;
        let fails = |case: &&Case| {
            let bar = given_back_on_bad_links(std::iter::once(*case));
            bar.is_some_and(|bar| !bar.ok) || -beyond_mj(case) < LEAST_ENERGY_MJ
        };
        let over = || own.iter().copied().filter(is_over);
        BadLinks {
            is_unguarded,
            cases: own.len(),
            over: over().count(),
            failing: over().filter(fails).count(),
            most_mj: own.iter().map(|case| mj(case)).fold(0.0, f64::max),
            most_beyond_taken_mj: own.iter().map(|case| beyond_mj(case)).fold(0.0, f64::max),
        }
    };
    let both = [false, true].map(of).into_iter();
    both.filter(|found| found.cases > 0).collect()
}

/// Whether some trials count.
type Is<'a> = &'a dyn Fn(&Spread) -> bool;

fn of_spreads(spreads: &[Spread]) -> Vec<Bar> {
    let mut bars = Vec::new();
    let mut most =
        |name: &str, counts: &dyn Fn(&Spread) -> bool, figure: &dyn Fn(&Spread) -> f64, bar| {
            let bound = Bound {
                name,
                at_least: false,
                bar,
            };
            let of = spreads.iter().filter(|spread| counts(spread));
            bars.extend(bound.judge(of.map(|spread| (figure(spread), spread.worst.clone()))));
        };
    let is_linear = |s: &Spread| ["palpation", "needle"].contains(&s.scene.as_str());
    let is_slab = |s: &Spread| ["corotational", "hyperelastic"].contains(&s.scene.as_str());
    let stalls = |s: &Spread| s.factor == "stalls" && (is_linear(s) || is_slab(s));
    let rubs = |s: &Spread| s.factor == "stalls" && s.scene == "rubbing";
    let of_stalls: [(&str, Is<'_>); 2] = [("stalls", &stalls), ("stalls, tools that rub", &rubs)];
    for (what, is) in of_stalls {
        // Of all seeds together.
        most(
            &format!("{what}, contact beyond notice %"),
            &|s| is(s) && s.runs as u64 >= SEEDS,
            &|s| s.beyond_of_all_pct,
            2.0,
        );
        most(
            &format!("{what}, dropouts a minute"),
            is,
            &|s| s.dropouts_per_min,
            0.0,
        );
    }
    most(
        "taps of tools that rub, every phase, rms p95 %",
        &|s| s.factor == "phase" && s.scene == "rubbing" && s.hand == "taps",
        &|s| s.rms_pct.p95,
        3.0,
    );
    let rms: [(&str, Is<'_>, f64, f64); 4] = [
        ("linear", &is_linear, 3.0, 6.0),
        ("tools that rub", &|s| s.scene == "rubbing", 3.0, 6.0),
        ("corotational", &|s| s.scene == "corotational", 5.0, 10.0),
        ("hyperelastic", &|s| s.scene == "hyperelastic", 5.0, 10.0),
    ];
    for (tissue, is, p95, worst) in rms {
        let counts = |s: &Spread| s.factor == "stalls" && is(s);
        most(
            &format!("stalls, {tissue}, rms p95 %"),
            &counts,
            &|s| s.rms_pct.p95,
            p95,
        );
        most(
            &format!("stalls, {tissue}, rms worst %"),
            &counts,
            &|s| s.rms_pct.worst,
            worst,
        );
    }
    // Drawn back from where no frame has seen it; half as much again as a finger notices.
    most(
        "stalls, needle, peak %",
        &|s| s.factor == "stalls" && s.scene == "needle",
        &|s| s.peak_pct.worst,
        15.0,
    );
    let slow = |s: &Spread| s.factor == "phase" && s.host_hz == 30.0 && s.hand == "taps";
    most(
        "taps at 30 Hz, every phase, rms p95 %",
        &slow,
        &|s| s.rms_pct.p95,
        4.0,
    );
    let sudden =
        |s: &Spread| ["planned", "phase"].contains(&s.factor) && is_slab(s) && s.hand == "taps";
    most(
        "taps on tissue that is not linear, every phase, rms p95 %",
        &sudden,
        &|s| s.rms_pct.p95,
        3.0,
    );
    let punctured = |s: &Spread| s.factor == "phase" && s.punctures > 0 && s.host_hz == 60.0;
    most(
        "punctures, every phase, fall off %",
        &punctured,
        &|s| s.fall_off_pct.worst,
        10.0,
    );
    most(
        "punctures, every phase, ms",
        &punctured,
        &|s| s.fall_late_ms.worst,
        5.0,
    );
    let stalled = |s: &Spread| s.factor == "stalls" && s.punctures > 0;
    most(
        "punctures missed with stalls, beyond their share of time, points",
        &stalled,
        &|s| s.missed_pct - s.stalled_pct,
        2.0,
    );
    // Beside the same scene as it stands, on a console that has no axes: else the steps of its encoders turn, too.
    let change = |s: &Spread| {
        let same = |other: &&Spread| {
            other.factor == "isotropic" && other.scene == s.scene && other.hand == s.hand
        };
        let straight = spreads.iter().find(same)?;
        Some((s.rms_pct.worst - straight.rms_pct.worst).abs())
    };
    most(
        "turned scene, change of rms, points",
        &|s| s.factor == "isotropic-turn" && change(s).is_some(),
        &|s| change(s).unwrap_or(0.0),
        0.1,
    );
    for (what, scene) in [
        ("round body of 8 mm", "round-8-mm"),
        ("round body of 8 mm, tool that rubs", "rubbing-round-8-mm"),
    ] {
        let round = |s: &Spread| ["planned", "phase"].contains(&s.factor) && s.scene == scene;
        most(
            &format!("{what}, direction p95 degrees"),
            &round,
            &|s| s.direction_p95_deg.worst,
            10.0,
        );
        most(&format!("{what}, rms %"), &round, &|s| s.rms_pct.worst, 5.0);
    }
    let all = |s: &Spread| s.factor != "draw";
    most(
        "given back in 100 ms, trials, mJ",
        &all,
        &|s| s.given_back_mj.worst,
        GIVEN_BACK_MJ,
    );
    bars
}

fn of_corners(lines: &[Line]) -> Vec<Bar> {
    let mut bars = Vec::new();
    let named = |line: &Line| format!("corner {} {}", line.hand, line.device);
    let mut bound = |name: &str,
                     counts: &dyn Fn(&Line) -> bool,
                     figure: &dyn Fn(&Line) -> f64,
                     at_least,
                     bar| {
        let bound = Bound {
            name,
            at_least,
            bar,
        };
        let of = lines.iter().filter(|line| counts(line));
        bars.extend(bound.judge(of.map(|line| (figure(line), named(line)))));
    };
    let of_reference = |l: &Line| l.k_of_reference;
    let is_pen = |l: &Line| l.hand == "pen";
    bound(
        "stiffness 30 Hz as described, of its own reference",
        &|l| is_pen(l) && l.device == "nominal",
        &of_reference,
        true,
        0.9,
    );
    bound(
        "stiffness 30 Hz, corners, of their own references",
        &|_| true,
        &of_reference,
        true,
        0.5,
    );
    let of_before = |l: &Line| before(&l.device, &l.hand).map_or(0.0, |k| l.k_max_n_per_m / k);
    bound(
        "stiffness 30 Hz, corners, of what it was",
        &|_| true,
        &of_before,
        true,
        1.0,
    );
    let late = |l: &Line| ["+1-tick", "lag-1-ms"].contains(&l.device.as_str());
    bound(
        "stiffness 30 Hz, a tick or 1 ms later, of what it was",
        &late,
        &of_before,
        true,
        1.5,
    );
    bound(
        "given back in 100 ms, corners, mJ",
        &|_| true,
        &|l| l.given_back_mj,
        false,
        GIVEN_BACK_MJ,
    );
    bars
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corners_before_are_all_there() {
        for spec in corners::specs() {
            let case = spec.case();
            let k = before(&case.device, &case.grasp);
            assert!(k.is_some_and(|k| k > 40.0), "{}", case.case);
        }
        assert_eq!(before("nominal", "none"), None);
    }

    /// The worst counts, a missed bar is open only if it is known to be, and none that is not there is judged.
    #[test]
    fn the_worst_is_judged() {
        let bound = |at_least| Bound {
            name: "of a test",
            at_least,
            bar: 2.0,
        };
        let figures = || [1.0, 3.0, 2.0].map(|x| (x, format!("{x}"))).into_iter();
        let most = bound(false).judge(figures()).expect("judged");
        assert!(!most.ok && !most.open && most.value == 3.0 && most.worst == "3");
        let least = bound(true).judge(figures()).expect("judged");
        assert!(!least.ok && least.value == 1.0);
        let met = bound(false).judge([(2.0, String::new())].into_iter());
        assert!(met.expect("judged").ok);
        assert_eq!(bound(false).judge(std::iter::empty()), None);
        for (name, known) in OPEN {
            let at_least = name.starts_with("stiffness 30 Hz, corners");
            let worse = if at_least { 0.99 * known } else { 1.01 * known };
            assert!(is_open(name, at_least, *known) && !is_open(name, at_least, worse));
        }
        assert!(!is_open("another", false, 0.0));
    }

    /// What is as it is known to be is not told, nor what is not open, nor what is worse.
    #[test]
    fn an_open_bar_that_has_become_better_is_told() {
        for (name, known) in OPEN {
            let at_least = name.starts_with("stiffness 30 Hz, corners");
            let sign = if at_least { 1.0 } else { -1.0 };
            let told = |name: &str, times: f64| {
                tighten(&[Bar {
                    name: name.to_owned(),
                    value: known * (1.0 + sign * times),
                    must_be: if at_least { ">=" } else { "<=" },
                    bar: 1.0,
                    ok: false,
                    open: true,
                    worst: String::new(),
                }])
            };
            let better = told(name, 0.06);
            assert_eq!(better.len(), 1, "{name}");
            assert_eq!((better[0].name.as_str(), better[0].known), (*name, *known));
            assert!(told(name, 0.04).is_empty() && told(name, -0.1).is_empty());
            assert!(told("another", 0.06).is_empty());
        }
    }
}
