//! The tables as pictures: line charts in SVG.
//!
//! Entry point: [`all`].

use std::fmt::Write as _;
use sutura_host::fidelity::case::{Case, Place, Scenes, Spec};
use sutura_host::fidelity::hand::Motion;
use sutura_shared::control::Rendering;

/// Size of a chart, and its margins \[px\].
const SIZE: (f64, f64) = (760.0, 440.0);
const LEFT: f64 = 80.0;
const RIGHT: f64 = 190.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 56.0;
/// Told apart by colour-blind eyes as well (Okabe and Ito 2008).
const COLOURS: [&str; 7] = [
    "#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9",
];

/// Some points, in order.
struct Line {
    name: String,
    points: Vec<(f64, f64)>,
}

/// One picture.
struct Chart {
    title: String,
    x: &'static str,
    y: &'static str,
    /// Logarithmic axes.
    logarithmic: (bool, bool),
    lines: Vec<Line>,
}

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
    let ideal = |case: &&Case| {
        case.tangent_scale == 1.0 && (case.host_hz == 30.0 || case.rendering == "full")
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
    let own = |case: &&Case| case.rendering == "tangent" && case.device_damping_n_s_per_m == 0.5;
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
        case.scene == scene
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
            });
        }
        lines.push(Line {
            name: spec.case().rendering.to_owned(),
            points: second()
                .map(|tick| (tick.time_s, tick.acting_n[2]))
                .collect(),
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
                points: Vec::new(),
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

/// One axis: from values to 0..1.
struct Axis {
    low: f64,
    high: f64,
    logarithmic: bool,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>, logarithmic: bool) -> Self {
        let floor = if logarithmic { 1e-3 } else { f64::NEG_INFINITY };
        let (low, high) = values
            .map(|value| value.max(floor))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        let (low, high) = if logarithmic {
            (low / 1.2, high * 1.2)
        } else {
            let room = 0.05 * (high - low).max(1e-6);
            (low - room, high + room)
        };
        Axis {
            low,
            high,
            logarithmic,
        }
    }

    fn at(&self, value: f64) -> f64 {
        if self.logarithmic {
            (value.max(1e-3) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    fn ticks(&self) -> Vec<f64> {
        let mut ticks = Vec::new();
        if self.logarithmic {
            let mut decade = 10f64.powf(self.low.log10().floor());
            while decade < self.high {
                ticks.extend([1.0, 2.0, 5.0].map(|step| step * decade));
                decade *= 10.0;
            }
        } else {
            let raw = (self.high - self.low) / 6.0;
            let decade = 10f64.powf(raw.log10().floor());
            let step = [1.0, 2.0, 5.0, 10.0]
                .into_iter()
                .map(|step| step * decade)
                .find(|step| *step >= raw)
                .unwrap_or(raw);
            let mut tick = (self.low / step).ceil() * step;
            while tick <= self.high {
                ticks.push(tick);
                tick += step;
            }
        }
        ticks.retain(|tick| (self.low..=self.high).contains(tick));
        ticks
    }
}

impl Chart {
    fn svg(&self) -> String {
        let all = || self.lines.iter().flat_map(|line| &line.points);
        let x_axis = Axis::over(all().map(|point| point.0), self.logarithmic.0);
        let y_axis = Axis::over(all().map(|point| point.1), self.logarithmic.1);
        let (width, height) = SIZE;
        let (right, bottom) = (width - RIGHT, height - BOTTOM);
        let x = |value: f64| LEFT + x_axis.at(value) * (right - LEFT);
        let y = |value: f64| bottom - y_axis.at(value) * (bottom - TOP);
        let mut svg = String::new();
        let _ = write!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
             font-size=\"12\"><rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\
             <text x=\"{LEFT}\" y=\"24\" font-size=\"14\">{}</text>",
            escaped(&self.title)
        );
        for tick in x_axis.ticks() {
            let at = x(tick);
            let _ = write!(
                svg,
                "<path d=\"M{at:.1} {TOP}V{bottom}\" stroke=\"#dddddd\"/>\
                 <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                bottom + 18.0,
                number(tick)
            );
        }
        for tick in y_axis.ticks() {
            let at = y(tick);
            let _ = write!(
                svg,
                "<path d=\"M{LEFT} {at:.1}H{right}\" stroke=\"#dddddd\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                LEFT - 6.0,
                at + 4.0,
                number(tick)
            );
        }
        for (index, line) in self.lines.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let points: Vec<_> = line
                .points
                .iter()
                .map(|point| format!("{:.1},{:.1}", x(point.0), y(point.1)))
                .collect();
            let at = TOP + 16.0 + 18.0 * index as f64;
            let _ = write!(
                svg,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\
                 <path d=\"M{:.1} {:.1}h20\" stroke=\"{colour}\" stroke-width=\"2\"/>\
                 <text x=\"{:.1}\" y=\"{at:.1}\">{}</text>",
                points.join(" "),
                right + 12.0,
                at - 4.0,
                right + 38.0,
                escaped(&line.name)
            );
        }
        let _ = write!(
            svg,
            "<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" fill=\"none\" stroke=\"#000000\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(18 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text></svg>",
            0.5 * (LEFT + right),
            height - 12.0,
            escaped(self.x),
            0.5 * (TOP + bottom),
            escaped(self.y)
        );
        svg
    }
}

/// As short as it can be read.
fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chart is sound XML, and its points lie within the frame.
    #[test]
    fn charts_are_svg() {
        let chart = Chart {
            title: "a < b & c".to_owned(),
            x: "x",
            y: "y",
            logarithmic: (true, false),
            lines: vec![Line {
                name: "one".to_owned(),
                points: vec![(1.0, -2.0), (10.0, 5.0), (1000.0, 0.0)],
            }],
        };
        let svg = chart.svg();
        let document = roxmltree::Document::parse(&svg).expect("XML");
        let line = document
            .descendants()
            .find(|node| node.has_tag_name("polyline"))
            .expect("a line");
        let points: Vec<(f64, f64)> = line
            .attribute("points")
            .expect("points")
            .split(' ')
            .map(|point| {
                let (x, y) = point.split_once(',').expect("a pair");
                (x.parse().expect("a number"), y.parse().expect("a number"))
            })
            .collect();
        assert_eq!(points.len(), 3);
        for (x, y) in points {
            assert!((LEFT..=SIZE.0 - RIGHT).contains(&x) && (TOP..=SIZE.1 - BOTTOM).contains(&y));
        }
    }
}
