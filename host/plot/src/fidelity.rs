//! Pictures of `sutura fidelity`: stability over the device's damping, errors over the host's rate, force over time.

use crate::Error;
use crate::axis::Axis;
use crate::chart::{Chart, Series, Shown};
use serde::Deserialize;
use serde_json::Value;

#[derive(Deserialize)]
struct Report {
    cases: Vec<Case>,
    #[serde(default)]
    traces: Vec<Trace>,
}

#[derive(Deserialize)]
struct Case {
    case: String,
    question: String,
    scene: String,
    hand: String,
    grasp: String,
    rendering: String,
    host_hz: f64,
    loss: f64,
    burst_ms: f64,
    reordered: f64,
    tangent_scale: f64,
    device_damping_n_s_per_m: f64,
    #[serde(default)]
    guards_off: Vec<String>,
    k_max_n_per_m: Option<f64>,
    rms_pct: Option<f64>,
}

/// Force of one rendering over time. JSON has no number for what is none.
#[derive(Deserialize)]
struct Trace {
    hand: String,
    rendering: String,
    time_s: Vec<Option<f64>>,
    force_n: Vec<Option<f64>>,
}

/// Names of files without their ending, and what is in them; without those that would have no line.
pub fn charts(report: &Value) -> Result<Vec<(String, Chart)>, Error> {
    let Report { cases, traces } = Report::deserialize(report)?;
    let mut charts = vec![
        ("stability-k-b".to_owned(), stability(&cases)),
        ("stability-wrong-tangent".to_owned(), wrong_tangents(&cases)),
    ];
    let mut hands: Vec<&str> = Vec::new();
    for case in &cases {
        if !hands.contains(&case.hand.as_str()) {
            hands.push(&case.hand);
        }
    }
    for scene in ["point", "palpation"] {
        for hand in &hands {
            charts.push((format!("errors-{scene}-{hand}"), rates(&cases, scene, hand)));
        }
    }
    let mut traced: Vec<&str> = traces.iter().map(|trace| trace.hand.as_str()).collect();
    traced.dedup();
    for hand in traced {
        charts.push((format!("trace-palpation-{hand}"), trace(&traces, hand)));
    }
    charts.retain(|(_, chart)| chart.series.iter().any(|series| series.points.len() > 1));
    Ok(charts)
}

/// The largest stable stiffness over the device's damping.
fn stability(cases: &[Case]) -> Chart {
    // Corners have a stiffness, too.
    let ideal = |case: &&Case| {
        case.question == "stability"
            && case.tangent_scale == 1.0
            && (case.host_hz == 30.0 || case.rendering == "full")
    };
    Chart {
        title: "Stable below the line: stiffness over the console's damping, host at 30 Hz, 33 ms"
            .to_owned(),
        x: logarithmic("damping of the console b [N s/m]"),
        y: logarithmic("stiffness K [N/m]"),
        series: by(
            cases.iter().filter(ideal),
            |case| case.rendering.clone(),
            |case| Some((case.device_damping_n_s_per_m, case.k_max_n_per_m?)),
        ),
        ..Chart::default()
    }
}

fn wrong_tangents(cases: &[Case]) -> Chart {
    let own = |case: &&Case| {
        case.question == "stability"
            && case.rendering == "tangent"
            && case.device_damping_n_s_per_m == 0.5
    };
    Chart {
        title: "Stable below the line: stiffness over the error of the tangent".to_owned(),
        x: logarithmic("tangent sent / true tangent [1]"),
        y: logarithmic("stiffness K [N/m]"),
        series: by(
            cases.iter().filter(own),
            |case| format!("{:.0} Hz", case.host_hz),
            |case| Some((case.tangent_scale, case.k_max_n_per_m?)),
        ),
        ..Chart::default()
    }
}

fn rates(cases: &[Case], scene: &str, hand: &str) -> Chart {
    let own = |case: &&Case| {
        let ideal = case.loss == 0.0 && case.burst_ms == 0.0 && case.reordered == 0.0;
        let is_budget = case.case.contains("-rows");
        // Trials have errors, too, and baselines are measured without guards as well.
        case.question == "errors"
            && case.guards_off.is_empty()
            && case.scene == scene
            && case.hand == hand
            && case.grasp == "rigid"
            && case.rendering != "full"
            && case.tangent_scale == 1.0
            && ideal
            && !is_budget
    };
    Chart {
        title: format!("{scene}, {hand}: error of the force over the host's rate"),
        x: logarithmic("host rate [Hz], delay one period"),
        y: logarithmic("RMS error [% of the largest force]"),
        series: by(
            cases.iter().filter(own),
            |case| case.rendering.clone(),
            |case| Some((case.host_hz, case.rms_pct?)),
        ),
        ..Chart::default()
    }
}

/// Force along the skin's normal in a second of one hand's motion.
fn trace(traces: &[Trace], hand: &str) -> Chart {
    let own = traces.iter().filter(|trace| trace.hand == hand);
    let number =
        |(x, y): (&Option<f64>, &Option<f64>)| (x.unwrap_or(f64::NAN), y.unwrap_or(f64::NAN));
    let series = own.map(|trace| Series {
        name: trace.rendering.clone(),
        points: trace
            .time_s
            .iter()
            .zip(&trace.force_n)
            .map(number)
            .collect(),
        shown: if trace.rendering == "true" {
            Shown::Bound
        } else {
            Shown::Joined
        },
        ..Series::default()
    });
    Chart {
        title: format!("palpation, {hand}: force on the hand, host at 30 Hz, 33 ms"),
        x: Axis {
            title: "time [s]".to_owned(),
            ..Axis::default()
        },
        y: Axis {
            title: "force along the normal [N]".to_owned(),
            ..Axis::default()
        },
        series: series.collect(),
        ..Chart::default()
    }
}

fn logarithmic(title: &str) -> Axis {
    Axis {
        title: title.to_owned(),
        logarithmic: true,
        most: None,
    }
}

/// Renderings in the order in which every picture has them: the same one looks the same.
const RENDERINGS: [&str; 5] = ["full", "hold", "linear-time", "tangent", "rows"];

/// Lines by name, renderings in their order and others in that of their first case; points by x.
fn by<'a>(
    cases: impl Iterator<Item = &'a Case>,
    name: impl Fn(&Case) -> String,
    point: impl Fn(&Case) -> Option<(f64, f64)>,
) -> Vec<Series> {
    let mut lines: Vec<Series> = Vec::new();
    for case in cases {
        let Some((x, y)) = point(case) else { continue };
        let name = name(case);
        if !lines.iter().any(|line| line.name == name) {
            lines.push(Series {
                name: name.clone(),
                shown: Shown::Joined,
                ..Series::default()
            });
        }
        if let Some(line) = lines.iter_mut().find(|line| line.name == name) {
            line.points.retain(|(other, _)| *other != x);
            line.points.push((x, y));
        }
    }
    let place = |line: &Series| RENDERINGS.iter().position(|name| *name == line.name);
    lines.sort_by_key(|line| place(line).unwrap_or(RENDERINGS.len()));
    for line in &mut lines {
        line.points.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// What was asked for something else has no place in a line, however alike it is.
    #[test]
    fn lines_are_of_the_cases_that_they_are_about() {
        let case = |question: &str| {
            json!({
                "case": question, "question": question, "scene": "point", "hand": "taps", "grasp": "rigid",
                "rendering": "tangent", "host_hz": 30.0, "loss": 0.0, "burst_ms": 0.0, "reordered": 0.0,
                "tangent_scale": 1.0, "device_damping_n_s_per_m": 0.5, "k_max_n_per_m": 1e3, "rms_pct": 1.0,
            })
        };
        let cases = ["errors", "stability", "corner", "trial", "return"].map(case);
        let report = Report::deserialize(json!({ "cases": cases })).expect("a report");
        for chart in [
            stability(&report.cases),
            wrong_tangents(&report.cases),
            rates(&report.cases, "point", "taps"),
        ] {
            let points: usize = chart.series.iter().map(|line| line.points.len()).sum();
            assert_eq!(points, 1, "{}", chart.title);
        }
    }

    /// A baseline that was measured with and without guards is drawn with them, and a rendering looks the same in all pictures.
    #[test]
    fn lines_are_of_guarded_consoles_in_one_order() {
        let case = |rendering: &str, off: &[&str], rms_pct: f64| {
            json!({
                "case": rendering, "question": "errors", "scene": "point", "hand": "taps", "grasp": "rigid",
                "rendering": rendering, "host_hz": 30.0, "loss": 0.0, "burst_ms": 0.0, "reordered": 0.0, "tangent_scale": 1.0,
                "device_damping_n_s_per_m": 0.5, "guards_off": off, "k_max_n_per_m": null, "rms_pct": rms_pct,
            })
        };
        let cases = [
            case("rows", &[], 1.0),
            case("hold", &[], 20.0),
            case("hold", &["tank", "damping"], 10.0),
        ];
        let report = Report::deserialize(json!({ "cases": cases })).expect("a report");
        let series = rates(&report.cases, "point", "taps").series;
        let drawn: Vec<_> = series
            .iter()
            .map(|line| (line.name.as_str(), line.points[0].1))
            .collect();
        assert_eq!(drawn, [("hold", 20.0), ("rows", 1.0)]);
    }
}
