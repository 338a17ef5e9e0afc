//! Error over time: one picture for each case of `sutura tradeoff`, with the front numbered as its table is.

use crate::Error;
use crate::axis::Axis;
use crate::chart::{Chart, Series, Shown};
use serde::Deserialize;
use serde_json::Value;

/// What has ten times the answer's size for an error is no answer: how far it is off says nothing.
const MOST_PCT: f64 = 1000.0;

#[derive(Deserialize)]
struct Report {
    truths: Vec<Truth>,
    cases: Vec<Row>,
    /// A table of its own, with the neo-Hookean tissue on the finest mesh for an answer.
    #[serde(default)]
    sutures: Vec<Suture>,
}

#[derive(Deserialize)]
struct Suture {
    case: String,
    tissue: String,
    step_us: Option<f64>,
    error_pct: Option<f64>,
}

#[derive(Deserialize)]
struct Truth {
    case: String,
}

/// JSON has no number for what has failed.
#[derive(Deserialize)]
struct Row {
    case: String,
    tissue: String,
    step_us: Option<f64>,
    error_pct: Option<f64>,
    pareto: bool,
}

impl Row {
    fn point(&self) -> (f64, f64) {
        let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
        (1e-3 * number(self.step_us), number(self.error_pct))
    }

    /// Models of a kind share a mark.
    fn kind(&self) -> String {
        self.tissue.replace("-neo-hookean", "")
    }
}

/// Names of files without their ending, and what is in them.
pub fn charts(report: &Value) -> Result<Vec<(String, Chart)>, Error> {
    let report = Report::deserialize(report)?;
    let chart = |truth: &Truth| {
        let rows = report.cases.iter().filter(|row| row.case == truth.case);
        let rows: Vec<_> = rows.collect();
        (
            format!("tradeoff-{}", truth.case),
            chart(&truth.case, &rows),
        )
    };
    let mut charts: Vec<_> = report.truths.iter().map(chart).collect();
    if let Some(first) = report.sutures.first() {
        let name = format!("tradeoff-{}", first.case);
        charts.push((name, sewn(&first.case, &report.sutures)));
    }
    Ok(charts)
}

fn sewn(case: &str, rows: &[Suture]) -> Chart {
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let point = (1e-3 * number(row.step_us), number(row.error_pct));
        match series.iter_mut().find(|own| own.name == row.tissue) {
            Some(own) => own.points.push(point),
            None => series.push(Series {
                name: row.tissue.clone(),
                points: vec![point],
                ..Series::default()
            }),
        }
    }
    Chart {
        title: format!("{case}: gap and tension against the time of a step"),
        note: "The answer itself, hyperelastic tissue on the finest mesh, has no error to show."
            .to_owned(),
        x: Axis {
            title: "median step while the thread is pulled [ms]".to_owned(),
            logarithmic: true,
            most: None,
        },
        y: Axis {
            title: "larger error of gap and tension [%]".to_owned(),
            logarithmic: true,
            most: Some(MOST_PCT),
        },
        series,
    }
}

fn chart(case: &str, rows: &[&Row]) -> Chart {
    let mut front: Vec<_> = rows
        .iter()
        .filter(|row| row.pareto)
        .map(|row| row.point())
        .collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let numbers = (1..=front.len()).map(|number| number.to_string());
    let bound = Series {
        name: "front".to_owned(),
        labels: numbers.collect(),
        points: front,
        shown: Shown::Bound,
    };
    let mut series = vec![bound];
    // In the same order in all pictures.
    let mut kinds: Vec<_> = rows.iter().map(|row| row.kind()).collect();
    kinds.sort();
    kinds.dedup();
    for kind in kinds {
        let own = rows.iter().filter(|row| row.kind() == kind);
        series.push(Series {
            points: own.map(|row| row.point()).collect(),
            name: kind,
            ..Series::default()
        });
    }
    Chart {
        title: format!("{case}: error against the time of a step"),
        note: "Nothing measured is both faster and nearer than the front. Its numbers are the table's.".to_owned(),
        x: Axis {
            title: "time of a step [ms]".to_owned(),
            logarithmic: true,
            most: None,
        },
        y: Axis {
            title: "largest error against quadratic cells [%]".to_owned(),
            logarithmic: true,
            most: Some(MOST_PCT),
        },
        series,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn fronts_are_numbered_by_time_and_failures_counted() {
        let row = |tissue: &str, us: Option<f64>, pct: Option<f64>, pareto: bool| json!({"case": "a", "tissue": tissue, "step_us": us, "error_pct": pct, "pareto": pareto});
        let report = json!({
            "truths": [{"case": "a"}, {"case": "b"}],
            "cases": [
                row("linear", Some(900.0), Some(1.0), true),
                row("linear", Some(20.0), Some(30.0), true),
                row("energy-balance-neo-hookean", Some(2e3), Some(1e21), false),
                row("chainmail", Some(5.0), None, false),
            ],
        });
        let charts = charts(&report).expect("two pictures");
        assert_eq!(charts.len(), 2);
        let (name, chart) = &charts[0];
        assert_eq!(name, "tradeoff-a");
        assert_eq!(chart.series[0].points, [(0.02, 30.0), (0.9, 1.0)]);
        assert_eq!(chart.series[0].labels, ["1", "2"]);
        let names: Vec<_> = chart
            .series
            .iter()
            .map(|series| series.name.as_str())
            .collect();
        assert_eq!(names, ["front", "chainmail", "energy-balance", "linear"]);
        let svg = chart.svg().expect("a picture");
        assert!(svg.contains("1 beyond") && svg.contains("1 no numbers"));
    }

    #[test]
    fn a_suture_has_a_picture_of_its_own() {
        let row = |tissue: &str, us: f64, pct: Option<f64>| json!({"case": "sewn", "tissue": tissue, "step_us": us, "error_pct": pct});
        let report = json!({
            "truths": [], "cases": [],
            "sutures": [
                row("linear", 500.0, Some(30.0)),
                row("linear", 2e3, Some(20.0)),
                row("hyperelastic", 9e3, Some(10.0)),
                row("hyperelastic", 4e4, None),
            ],
        });
        let charts = charts(&report).expect("a picture");
        let [(name, chart)] = &charts[..] else {
            panic!("{} pictures", charts.len());
        };
        assert_eq!(name, "tradeoff-sewn");
        assert_eq!(chart.series[0].points, [(0.5, 30.0), (2.0, 20.0)]);
        assert_eq!(chart.series.len(), 2);
        assert!(chart.svg().expect("a picture").contains("1 no numbers"));
    }
}
