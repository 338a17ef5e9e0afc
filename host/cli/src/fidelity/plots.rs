//! The tables as pictures: line charts in SVG.
//!
//! Entry point: [`all`].

use crate::chart::{Chart, Line};
use sutura_shared::control::Rendering;
use sutura_study::fidelity::case::{Case, Place, Scenes, Spec};
use sutura_study::fidelity::hand::Motion;

/// File names and contents: stability over the device's damping, errors over the host's rate, force over time.
pub fn all(cases: &[Case], scenes: &Scenes) -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut add = |name: String, chart: Chart| {
        if chart.lines.iter().any(|line| line.points.len() > 1) {
            files.push((name, chart.svg()));
        }
    };
    add("stability-k-b.svg".to_owned(), stability(cases));
    add(
        "stability-wrong-tangent.svg".to_owned(),
        wrong_tangents(cases),
    );
    for scene in ["point", "palpation"] {
        for hand in Motion::NAMED.map(Motion::name) {
            add(
                format!("errors-{scene}-{hand}.svg"),
                rates(cases, scene, hand),
            );
        }
    }
    for motion in Motion::NAMED {
        let is_measured = |case: &Case| case.scene == "palpation" && case.hand == motion.name();
        if cases.iter().any(is_measured) {
            let name = format!("trace-palpation-{}.svg", motion.name());
            add(name, trace(scenes, motion));
        }
    }
    files
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
        x: "damping of the console b [N s/m]",
        y: "stiffness K [N/m]",
        logarithmic: (true, true),
        lines: by(
            cases.iter().filter(ideal),
            |case| case.rendering.to_owned(),
            |case| Some((case.device_damping_n_s_per_m, case.k_max_n_per_m?)),
        ),
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
        x: "tangent sent / true tangent",
        y: "stiffness K [N/m]",
        logarithmic: (true, true),
        lines: by(
            cases.iter().filter(own),
            |case| format!("{:.0} Hz", case.host_hz),
            |case| Some((case.tangent_scale, case.k_max_n_per_m?)),
        ),
    }
}

fn rates(cases: &[Case], scene: &str, hand: &str) -> Chart {
    let own = |case: &&Case| {
        let ideal = case.loss == 0.0 && case.burst_ms == 0.0 && case.reordered == 0.0;
        let is_budget = case.case.contains("-rows");
        // Trials have errors, too.
        case.question == "errors"
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
        x: "host rate [Hz], delay one period",
        y: "RMS error [% of the largest force]",
        logarithmic: (true, true),
        lines: by(
            cases.iter().filter(own),
            |case| case.rendering.to_owned(),
            |case| Some((case.host_hz, case.errors?.rms_pct)),
        ),
    }
}

/// Force along the skin's normal in a second of one hand's motion.
fn trace(scenes: &Scenes, motion: Motion) -> Chart {
    let mut lines = Vec::new();
    for rendering in [Rendering::Hold, Rendering::Tangent, Rendering::Rows] {
        let spec = Spec {
            seconds: 2.0,
            ..Spec::errors(Place::Palpation, motion, rendering, 30.0)
        };
        let Ok(record) = spec.record(scenes) else {
            continue;
        };
        let second = || record.ticks.iter().filter(|tick| tick.time_s >= 1.0);
        if lines.is_empty() {
            lines.push(Line {
                name: "true".to_owned(),
                points: second()
                    .map(|tick| (tick.time_s, tick.truth_n[2]))
                    .collect(),
                dots: Vec::new(),
            });
        }
        lines.push(Line {
            name: spec.case().rendering.to_owned(),
            points: second()
                .map(|tick| (tick.time_s, tick.acting_n[2]))
                .collect(),
            dots: Vec::new(),
        });
    }
    Chart {
        title: format!(
            "palpation, {}: force on the hand, host at 30 Hz, 33 ms",
            motion.name()
        ),
        x: "time [s]",
        y: "force along the normal [N]",
        logarithmic: (false, false),
        lines,
    }
}

/// Lines by name, in the order of their first case; points by x.
fn by<'a>(
    cases: impl Iterator<Item = &'a Case>,
    name: impl Fn(&Case) -> String,
    point: impl Fn(&Case) -> Option<(f64, f64)>,
) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for case in cases {
        let Some((x, y)) = point(case) else { continue };
        let name = name(case);
        if !lines.iter().any(|line| line.name == name) {
            lines.push(Line {
                name: name.clone(),
                ..Line::default()
            });
        }
        if let Some(line) = lines.iter_mut().find(|line| line.name == name) {
            line.points.retain(|(other, _)| *other != x);
            line.points.push((x, y));
        }
    }
    for line in &mut lines {
        line.points.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What was asked for something else has no place in a line, however alike it is.
    #[test]
    fn lines_are_of_the_cases_that_they_are_about() {
        let case = |question| Case {
            question,
            scene: "point".to_owned(),
            hand: "taps",
            grasp: "rigid".to_owned(),
            rendering: "tangent",
            host_hz: 30.0,
            tangent_scale: 1.0,
            device_damping_n_s_per_m: 0.5,
            k_max_n_per_m: Some(1e3),
            errors: Some(Default::default()),
            ..Case::default()
        };
        let all = ["errors", "stability", "corner", "trial", "return"].map(case);
        for chart in [
            stability(&all),
            wrong_tangents(&all),
            rates(&all, "point", "taps"),
        ] {
            let points: usize = chart.lines.iter().map(|line| line.points.len()).sum();
            assert_eq!(points, 1, "{}", chart.title);
        }
    }
}
