//! Line charts in SVG.
//!
//! Entry point: [`Chart::svg`].

use std::fmt::Write as _;

/// Size of a chart, and its margins \[px\].
const SIZE: (f64, f64) = (760.0, 440.0);
const LEFT: f64 = 80.0;
const RIGHT: f64 = 190.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 56.0;
/// Told apart by colour-blind eyes as well (Okabe and Ito 2008).
const COLOURS: [&str; 12] = [
    "#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999",
    "#7f3c8d", "#8c564b", "#bcbd22", "#1b5e20",
];

/// Some points, in order.
#[derive(Default)]
pub struct Line {
    /// In the legend.
    pub name: String,
    /// In the chart's units.
    pub points: Vec<(f64, f64)>,
    /// Points that get a dot, whether joined or not.
    pub dots: Vec<(f64, f64)>,
}

/// One picture.
pub struct Chart {
    /// Above it.
    pub title: String,
    /// Label of the axis.
    pub x: &'static str,
    /// Label of the axis.
    pub y: &'static str,
    /// Logarithmic axes.
    pub logarithmic: (bool, bool),
    /// What it shows.
    pub lines: Vec<Line>,
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
            // Within one decade three would leave a reader to guess.
            let steps: &[f64] = if self.high / self.low < 12.0 {
                &[1.0, 2.0, 3.0, 4.0, 6.0, 8.0]
            } else {
                &[1.0, 2.0, 5.0]
            };
            while decade < self.high {
                ticks.extend(steps.iter().map(|step| step * decade));
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
    /// As a file.
    pub fn svg(&self) -> String {
        let all = || {
            let lines = self.lines.iter();
            lines.flat_map(|line| line.points.iter().chain(&line.dots))
        };
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
            for (px, py) in &line.dots {
                let _ = write!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{colour}\"/>",
                    x(*px),
                    y(*py)
                );
            }
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
                dots: vec![(10.0, 5.0)],
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
