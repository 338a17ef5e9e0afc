//! A needle draws a thread through two slabs and both ends are pulled: how well that closes, how tense the thread is, and what a
//! step costs, on every tissue that needles go through and on finer and finer meshes.
//!
//! Entry points: [`plan`], [`measure`]. There is no other program's answer to this: the truth is the neo-Hookean tissue's on the
//! finest mesh on which it comes to its end.

use super::measure::Extent;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;
use sutura_host::collide::gaps_m;
use sutura_host::scene::{Document, Scene, SceneError, position_at};
use sutura_host::session::{SceneSolver, SolveError};
use sutura_host::step::{Status, StepReport};
use sutura_host::tool::ToolSample;

/// Word for tables and `--only`.
pub const CASE: &str = "suture-closed";
/// What is done.
pub const ABOUT: &str = "two slabs 20 x 16 x 10 mm, 4 mm apart, E 30 kPa, nu 0.45, a bite of a half-circle needle of 8 mm through both, the thread's ends pulled up and together, 3 mm each";

/// As scenes name them; the last is the truth's.
const TISSUES: [&str; 3] = ["linear", "corotational", "hyperelastic"];
/// Cubes of each slab.
const LEVELS: [[usize; 3]; 3] = [[5, 4, 3], [7, 5, 4], [10, 8, 5]];
/// Levels of the short table.
const SHORT: usize = 2;
/// Steps a second.
const HZ: f64 = 50.0;
/// When the needle is through and the ends are held, when they have been pulled, and when all has come to rest \[s\].
const SEWN_S: f64 = 1.0;
const PULLED_S: f64 = 2.0;
const END_S: f64 = 2.3;
/// Into the one slab and out of it, and the other.
const PUNCTURES: u32 = 4;
/// Most steps at one place.
const MOST_WAITS: u32 = 200;

/// Everything but the meshes' divisions and the tissue's model.
const SCENE: &str = r#"
name = "A bite through two slabs"
seconds = 2.3
device = "cartesian-bench"

[[mesh.part]]
name = "left"
slab = { size_m = [0.02, 0.016, 0.01], divisions = DIVISIONS }
at_m = [-0.012, 0.0, 0.0]

[[mesh.part]]
name = "right"
slab = { size_m = [0.02, 0.016, 0.01], divisions = DIVISIONS }
at_m = [0.012, 0.0, 0.0]

[tissue]
model = "MODEL"
youngs_modulus_pa = 30e3
poisson_ratio = 0.45

[tissue.needle]
friction_n_per_m = 0.0
puncture_pa = 5e5

[[fixed]]
plane = { axis = "x", at_m = -0.022 }

[[fixed]]
plane = { axis = "x", at_m = 0.022 }

[[needle]]
shape = "arc"
radius_m = 0.008
angle_deg = 180.0
thickness_m = 0.0006
end_m = [0.0079756, 0.0007, 0.0026245]
direction = [-0.0780678, 0.0, 0.9969481]
towards = [-0.9969481, 0.0, -0.0780678]
hold = [{ time_s = 0.0, tool = 1 }, { time_s = 0.78, tool = 0 }]

[[thread]]
needle = 0
length_m = 0.2
hold = [{ time_s = 0.96, end = "tail", tool = 2 }]

[[tissue_contact]]
between = ["left", "right"]
rims = [
  { box = { min_m = [-0.002, -0.008, -0.006], max_m = [-0.002, 0.008, 0.0] } },
  { box = { min_m = [0.002, -0.008, -0.006], max_m = [0.002, 0.008, 0.0] } },
]

[[tool]]
id = 0
shape = "grip"

[[tool]]
id = 1
shape = "grip"
reach_m = 0.01
way_point = [
  { time_s = 0.05, position_m = [0.0, 0.0007, 0.002] },
  { time_s = 0.75, position_m = [0.0, 0.0007, 0.002], rotation_deg = [0.0, -351.045, 0.0] },
]

[[tool]]
id = 2
shape = "grip"
reach_m = 0.01
way_point = [
  { time_s = 1.0, position_m = [-0.004, 0.0007, 0.006] },
  { time_s = 2.0, position_m = [-0.0024, 0.0007, 0.0085] },
]

[hand]
stiffness_n_per_m = 2000.0
damping_n_s_per_m = 20.0
way_point = [
  { time_s = 0.0, position_m = [0.0079756, 0.0007, 0.0013755] },
  { time_s = 0.8, position_m = [0.0079756, 0.0007, 0.0013755] },
  { time_s = 0.92, position_m = [0.004, 0.0007, 0.006] },
  { time_s = 1.0, position_m = [0.004, 0.0007, 0.006] },
  { time_s = 2.0, position_m = [0.0024, 0.0007, 0.0085] },
]

[host]
host_hz = 50.0
"#;

/// One line of the table. Numbers of what has failed are none.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Row {
    /// [`CASE`].
    pub case: &'static str,
    /// Name of the model.
    pub tissue: &'static str,
    /// Which mesh, from 1 on.
    pub level: usize,
    /// Nodes of the mesh.
    pub nodes: usize,
    /// Cells of the mesh.
    pub cells: usize,
    /// Mean gap of the rims at the end over that of the unloaded mesh.
    #[schemars(with = "Option<f64>")]
    pub gap_ratio: f64,
    /// Tension of the thread at the end \[N\].
    #[schemars(with = "Option<f64>")]
    pub tension_n: f64,
    /// Thread drawn out at both ends \[m\].
    #[schemars(with = "Option<f64>")]
    pub pulled_m: f64,
    /// Pairs of features that press at the end.
    pub touching: u32,
    /// Median and 99th hundredth of the steps in which the ends are pulled, columns at hand \[us\].
    #[schemars(with = "Option<f64>")]
    pub step_us: f64,
    /// See above.
    #[schemars(with = "Option<f64>")]
    pub p99_us: f64,
    /// How far the gap is off the truth's \[%\].
    #[schemars(with = "Option<f64>")]
    pub gap_off_pct: f64,
    /// How far the tension is \[%\].
    #[schemars(with = "Option<f64>")]
    pub tension_off_pct: f64,
    /// The larger of both \[%\].
    #[schemars(with = "Option<f64>")]
    pub error_pct: f64,
    /// `converged`, or `failed`.
    pub outcome: &'static str,
    /// Why it failed.
    pub note: String,
}

/// Tissues that are measured, chosen by names as cases are.
pub fn plan(words: &[&str]) -> Vec<&'static str> {
    let wanted = |tissue: &&str| {
        let is_in = |word: &&str| CASE.contains(*word) || tissue.contains(*word);
        words.iter().all(is_in)
    };
    TISSUES.into_iter().filter(wanted).collect()
}

fn levels(extent: Extent) -> usize {
    if extent.full { LEVELS.len() } else { SHORT }
}

/// Lines that a plan has.
pub fn lines(plan: &[&'static str], extent: Extent) -> usize {
    plan.len() * levels(extent)
}

/// Measures a plan. `told` is called with every line as it is found, which is before errors are, and says whether to go on: else there
/// are the lines by then, without errors.
pub fn measure(
    plan: &[&'static str],
    extent: Extent,
    told: &mut dyn FnMut(&Row) -> ControlFlow<()>,
) -> Vec<Row> {
    let mut rows = Vec::with_capacity(lines(plan, extent));
    for tissue in plan {
        for level in 1..=levels(extent) {
            let mut row = row(tissue, level);
            if !extent.timed {
                (row.step_us, row.p99_us) = (f64::NAN, f64::NAN);
            }
            let then = told(&row);
            rows.push(row);
            if then.is_break() {
                return rows;
            }
        }
    }
    compare(&mut rows);
    rows
}

/// Finds how far lines are off the neo-Hookean one on the finest mesh that has one; its own error is not known.
fn compare(rows: &mut [Row]) {
    let known = |row: &&Row| row.tissue == TISSUES[2] && !row.gap_ratio.is_nan();
    let finest = rows.iter().filter(known).max_by_key(|row| row.level);
    let Some(truth) = finest.cloned() else {
        return;
    };
    let is_true = |row: &Row| row.tissue == truth.tissue && row.level == truth.level;
    let off = |own: f64, truth: f64| 100.0 * (own / truth - 1.0).abs();
    for row in rows.iter_mut().filter(|row| !is_true(row)) {
        row.gap_off_pct = off(row.gap_ratio, truth.gap_ratio);
        row.tension_off_pct = off(row.tension_n, truth.tension_n);
        let known = !row.gap_off_pct.is_nan() && !row.tension_off_pct.is_nan();
        if known {
            row.error_pct = row.gap_off_pct.max(row.tension_off_pct);
        }
    }
}

fn failed(tissue: &'static str, level: usize) -> Row {
    Row {
        case: CASE,
        tissue,
        level,
        nodes: 0,
        cells: 0,
        gap_ratio: f64::NAN,
        tension_n: f64::NAN,
        pulled_m: f64::NAN,
        touching: 0,
        step_us: f64::NAN,
        p99_us: f64::NAN,
        gap_off_pct: f64::NAN,
        tension_off_pct: f64::NAN,
        error_pct: f64::NAN,
        outcome: "failed",
        note: String::new(),
    }
}

fn row(tissue: &'static str, level: usize) -> Row {
    let mut row = failed(tissue, level);
    match closed(&mut row) {
        Ok(()) => row.outcome = "converged",
        Err(why) => row.note = why,
    }
    row
}

fn scene(tissue: &str, level: usize) -> Result<Scene, SceneError> {
    let divisions = format!("{:?}", LEVELS[level - 1]);
    let text = SCENE.replace("DIVISIONS", &divisions);
    let text = text.replace("MODEL", tissue);
    Scene::read(&Document::embedded(CASE, Path::new(""), &text), CASE)
}

/// Sews, pulls once for the columns, and once again with a clock.
fn closed(row: &mut Row) -> Result<(), String> {
    let scene = scene(row.tissue, row.level).map_err(|error| error.to_string())?;
    row.nodes = scene.mesh.points_m().len();
    row.cells = scene.mesh.cells().len();
    let refused = |error: SolveError| error.to_string();
    let mut solver = SceneSolver::new(&scene).map_err(refused)?;
    follow(&scene, &mut solver, [0.0, SEWN_S])?;
    let sewn = solver.moment().ok_or("no rows")?;
    follow(&scene, &mut solver, [SEWN_S, PULLED_S])?;
    solver.go_on_from(&sewn);
    let (mut times_us, _) = follow(&scene, &mut solver, [SEWN_S, PULLED_S])?;
    let (_, last) = follow(&scene, &mut solver, [PULLED_S, END_S])?;
    times_us.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let index = (share * times_us.len() as f64) as usize;
        times_us.get(index.min(times_us.len() - 1)).copied()
    };
    row.step_us = quantile(0.5).unwrap_or(f64::NAN);
    row.p99_us = quantile(0.99).unwrap_or(f64::NAN);
    let thread = last.threads().first().ok_or("no thread")?;
    if thread.punctures != PUNCTURES {
        return Err(format!("{} punctures", thread.punctures));
    }
    row.tension_n = thread.tension_n[1];
    row.pulled_m = thread.pulled_m.iter().sum();
    row.touching = last.touching;
    let gap_m = |at: &[[f64; 3]]| {
        let at: Vec<Vector3<f64>> = at.iter().map(|at| Vector3::from(*at)).collect();
        let pair = &scene.touching[0];
        let mut gaps = gaps_m(&pair.rims[0], &pair.faces[1], &at);
        gaps.extend(gaps_m(&pair.rims[1], &pair.faces[0], &at));
        gaps.iter().sum::<f64>() / gaps.len() as f64
    };
    row.gap_ratio = gap_m(&solver.positions_m()) / gap_m(scene.mesh.points_m());
    Ok(())
}

/// Steps along the scripts after one time, up to another: how long each took \[us\], and the last.
fn follow(
    scene: &Scene,
    solver: &mut SceneSolver,
    [from_s, until_s]: [f64; 2],
) -> Result<(Vec<f64>, StepReport), String> {
    let hand = scene.hand.as_ref().ok_or("no hand")?;
    let [first, last] = [from_s, until_s].map(|time_s| (time_s * HZ).round() as u64);
    let (mut times_us, mut report) = (Vec::new(), StepReport::default());
    // A start of its own: nothing is before it.
    for number in first + u64::from(first > 0)..=last {
        let time_s = number as f64 / HZ;
        let sample = ToolSample {
            id: solver.driven().unwrap_or_default(),
            position_m: position_at(hand, time_s),
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: (1e6 * time_s).round() as u64,
        };
        let start = Instant::now();
        report = solver.step(sample);
        for _ in 0..MOST_WAITS {
            if !matches!(report.status, Status::Waiting | Status::Behind) {
                break;
            }
            report = solver.step(sample);
        }
        times_us.push(1e6 * start.elapsed().as_secs_f64());
        if report.status != Status::Ok {
            return Err(format!("{} at {time_s} s", report.status.name()));
        }
    }
    Ok((times_us, report))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(tissue: &'static str, level: usize, gap_ratio: f64, tension_n: f64) -> Row {
        Row {
            gap_ratio,
            tension_n,
            ..failed(tissue, level)
        }
    }

    #[test]
    fn lines_are_off_the_finest_neo_hookean_one() {
        let mut rows = vec![
            line("linear", 1, 0.6, 0.5),
            line("hyperelastic", 1, 0.5, 0.8),
            line("hyperelastic", 2, 0.5, 1.0),
            failed("corotational", 1),
        ];
        compare(&mut rows);
        assert!((rows[0].gap_off_pct - 20.0).abs() < 1e-9, "{:?}", rows[0]);
        assert!((rows[0].error_pct - 50.0).abs() < 1e-9, "{:?}", rows[0]);
        assert!((rows[1].error_pct - 20.0).abs() < 1e-9, "{:?}", rows[1]);
        assert!(rows[2].error_pct.is_nan() && rows[3].error_pct.is_nan());
    }
}
