//! What each model costs on this machine, and how far off it is, on the scene's own mesh under its own tool.
//!
//! Entry point: [`measure`]. Time is that of the session's solver with what the console is to render from. Force and
//! displacement come from the same press, under the one contact law of the scene: without friction, or with the tools' own.
//! Models that tools stick to have another, and are listed without a figure.

use super::way::Press;
use super::{Candidate, SAFE_SHARE, StepUs};
use nalgebra::Vector3;
use std::time::{Duration, Instant};
use sutura_host::scene::{Corotational, Pose, Registered, Scene, Tissue, models};
use sutura_host::script::Path;
use sutura_host::session::{Plan, Rendering, SceneSolver};
use sutura_host::step::{Status, StepReport};
use sutura_host::tool::ToolSample;

/// Steps of the press that are timed, and how many of them lie between two places at which forces are compared.
const STEPS: usize = 24;
const STEPS_A_PLACE: usize = 6;
/// Repetitions of the timed press, and how long one candidate may take for them; three times as long for the first.
const REPEATS: usize = 3;
const TIMED: Duration = Duration::from_millis(500);
/// After this the reference goes no deeper.
const LONGEST_REFERENCE: Duration = Duration::from_secs(3);
/// So long after the first no other model is measured: whoever asks is waiting.
const LONGEST: Duration = Duration::from_secs(9);
/// Most steps at a place that the reference takes to balance there, and a candidate to answer at all.
const MOST_AT_A_PLACE: usize = 20;
/// Slower than this share of the budget is too slow even on a machine that is busy with other things; known from three steps of
/// models that make their factors in the steps, else after so much time.
const TOO_SLOW: f64 = 2.0 * SAFE_SHARE;
const SURE: Duration = Duration::from_millis(400);
const SLOW: &str = "too slow";
/// The reference: neo-Hookean, each place balanced. It is a candidate itself, with as many steps as a session has.
const REFERENCE: (&str, &str) = ("hyperelastic", "linear cells, to 1e-3");
const BALANCED: f64 = 1e-3;
/// Passes of a corotational step in a session.
const COROTATIONAL: [u32; 2] = [1, 4];

const NO_TIME: &str = "not measured: no time left";
const STICKS: &str = "no candidate: tools stick to it, which is another contact";

/// What a session is to be.
#[derive(Clone, Copy, Debug)]
pub struct Asked<'a> {
    /// Its plan.
    pub plan: &'a Plan,
    /// What a step may take \[us\].
    pub budget_us: f64,
    /// What the console is to render from; if that is open, what each model gives at best.
    pub rendering: Option<Rendering>,
}

impl Asked<'_> {
    /// The plan with a tissue.
    fn plan(&self, tissue: Tissue) -> Plan {
        Plan {
            rendering: self.rendering.unwrap_or(tissue.usual_rendering()),
            ..*self.plan
        }
    }
}

/// What the tool felt at a place of the press \[N\], and where all nodes were then \[m\], (n x 3).
struct Place {
    force_n: Vector3<f64>,
    positions_m: Vec<[f64; 3]>,
}

/// Time of the steps in contact, and the places of the press that were reached, in order.
struct Run {
    step_us: StepUs,
    places: Vec<Place>,
}

/// Measures every model and setting that suits the scene; `told` hears of each before it begins and after. The scene's tissue is
/// as before at the end.
///
/// # Errors
/// Why nothing can be measured on this scene.
pub fn measure(
    scene: &mut Scene,
    asked: &Asked<'_>,
    told: &mut dyn FnMut(&str),
) -> Result<Vec<Candidate>, String> {
    if !scene.needles.is_empty() {
        return Err(
            "it has needles, which only linear, corotational and hyperelastic tissue take, and for which there is no reference"
                .to_owned(),
        );
    }
    if !scene.jaws.is_empty() {
        return Err(
            "it has jaws, which only linear, corotational and hyperelastic tissue take".to_owned(),
        );
    }
    let Some(press) = Press::of(scene) else {
        return Err("no tool is driven that touches".to_owned());
    };
    let before = scene.tissue;
    let found = compare_all(scene, asked, &press, told);
    scene.tissue = before;
    found
}

/// As [`measure`], with the scene's tissue as the last one timed.
fn compare_all(
    scene: &mut Scene,
    asked: &Asked<'_>,
    press: &Press,
    told: &mut dyn FnMut(&str),
) -> Result<Vec<Candidate>, String> {
    let way = press.places(STEPS);
    told("the reference");
    let (name, setting) = REFERENCE;
    let before = std::mem::replace(
        &mut scene.tissue,
        Tissue::Registered(Registered::new(name, Some(setting))?),
    );
    let reference = reference(scene, asked, &press.places(STEPS / STEPS_A_PLACE))?;
    let began = Instant::now();
    let mut candidates = Vec::new();
    for tissue in all(before) {
        let mut candidate = super::candidate(tissue);
        if !tissue.has_rows() {
            candidate.note = STICKS.to_owned();
        } else if began.elapsed() > LONGEST {
            candidate.note = NO_TIME.to_owned();
        } else {
            told(&candidate.tissue);
            scene.tissue = tissue;
            match run(scene, asked, &way) {
                Ok(run) => found(&mut candidate, &run, &reference, scene, asked.budget_us),
                Err(why) => candidate.note = why,
            }
        }
        candidates.push(candidate);
    }
    Ok(candidates)
}

/// Takes the time of a run, and its errors if it has gone as far as the reference.
fn found(candidate: &mut Candidate, run: &Run, reference: &[Place], scene: &Scene, budget_us: f64) {
    candidate.step_us = Some(run.step_us);
    if run.step_us.p50 > TOO_SLOW * budget_us {
        candidate.note = SLOW.to_owned();
    }
    if run.places.len() < reference.len() {
        return;
    }
    let (mut off, mut largest) = (0.0, 0.0_f64);
    let (mut apart, mut moved) = (0.0, 0.0);
    for (here, there) in run.places.iter().zip(reference) {
        off += (here.force_n - there.force_n).norm_squared();
        largest = largest.max(there.force_n.norm());
        let nodes = here.positions_m.iter().zip(&there.positions_m);
        for ((here, there), rest) in nodes.zip(scene.mesh.points_m()) {
            apart += (Vector3::from(*here) - Vector3::from(*there)).norm_squared();
            moved += (Vector3::from(*there) - Vector3::from(*rest)).norm_squared();
        }
    }
    candidate.error = Some((off / reference.len() as f64).sqrt() / largest);
    candidate.displacement_error = Some(f64::sqrt(apart / moved));
}

/// Models as sessions have them: first those that are quick on most meshes, so that what there is no time for would hardly
/// hold a budget; last those that tools stick to, once each. Corotational tissue keeps the scene's own settings.
fn all(scenes: Tissue) -> Vec<Tissue> {
    let mut all = vec![Tissue::Linear];
    all.extend(COROTATIONAL.map(|passes| {
        let tissue = Tissue::Corotational(Corotational {
            passes: Some(passes),
            ..Corotational::default()
        });
        tissue.instead_of(scenes)
    }));
    for entry in models() {
        if matches!(entry.tissue, "linear" | "corotational") {
            continue;
        }
        let short = entry.settings.iter().filter(|setting| setting.short);
        let found = short
            .filter_map(|setting| Registered::new(entry.tissue, Some(&setting.name)).ok())
            .map(Tissue::Registered);
        // What sticks does so with every setting.
        all.extend(
            found
                .enumerate()
                .filter_map(|(index, tissue)| (index == 0 || tissue.has_rows()).then_some(tissue)),
        );
    }
    all.sort_by_key(|tissue| !tissue.has_rows());
    all
}

fn sample(scene: &Scene, at: &[f64; 3], step: usize, asked: &Asked<'_>) -> ToolSample {
    ToolSample {
        id: scene.driven().map_or(0, |tool| tool.id),
        position_m: *at,
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        console_time_us: (1e6 * (step + 1) as f64 / asked.plan.host_hz) as u64,
    }
}

/// The reference's answers along the way, as far as there are any; the first place is outside.
fn reference(scene: &Scene, asked: &Asked<'_>, way: &[[f64; 3]]) -> Result<Vec<Place>, String> {
    let mut solver = SceneSolver::new(scene).map_err(|error| error.to_string())?;
    let started = Instant::now();
    let (mut places, mut touches) = (Vec::new(), false);
    for (step, at) in way.iter().enumerate() {
        let sample = sample(scene, at, step, asked);
        let Some(report) = rest(&mut solver, sample, |report| {
            report.passes == 0 || report.imbalance <= BALANCED
        }) else {
            break;
        };
        touches |= is_touching(&report);
        places.push(place(&solver, &report));
        if touches && started.elapsed() > LONGEST_REFERENCE {
            break;
        }
    }
    if !touches {
        return Err("the reference finds no balance on it".to_owned());
    }
    Ok(places)
}

/// Steps at a place until the step is good and `done`.
fn rest(
    solver: &mut SceneSolver,
    sample: ToolSample,
    done: impl Fn(&StepReport) -> bool,
) -> Option<StepReport> {
    for _ in 0..MOST_AT_A_PLACE {
        let report = solver.step(sample);
        match report.status {
            Status::Ok if done(&report) => return Some(report),
            Status::Ok | Status::Behind | Status::Waiting => {}
            _ => return None,
        }
    }
    None
}

/// What the driven tool feels, whose contact comes first.
fn place(solver: &SceneSolver, report: &StepReport) -> Place {
    let wrench = report.contacts().first().map_or([0.0; 6], |own| own.wrench);
    Place {
        force_n: Vector3::from_column_slice(&wrench[..3]),
        positions_m: solver.positions_m().into_owned(),
    }
}

fn is_touching(report: &StepReport) -> bool {
    let driven = report.contacts().first();
    driven.is_some_and(|contact| contact.rows > 0)
}

/// The session's solver, prepared as for its hand.
fn prepared(scene: &Scene, asked: &Asked<'_>, way: &[[f64; 3]]) -> Result<SceneSolver, String> {
    let plan = asked.plan(scene.tissue);
    let mut solver = SceneSolver::new(scene).map_err(|error| error.to_string())?;
    let grips = way.iter().map(|position_m| Pose {
        position_m: *position_m,
        orientation: [0.0, 0.0, 0.0, 1.0],
    });
    solver.prepare(&Path {
        grips: grips.collect(),
        ..Path::default()
    });
    solver.reduce_to(plan.most_rows(), 2.0 / plan.host_hz);
    Ok(solver)
}

/// Times the press and keeps what it finds; what is far too slow only as far as to know that.
fn run(scene: &Scene, asked: &Asked<'_>, way: &[[f64; 3]]) -> Result<Run, String> {
    let mut fastest_us: Vec<Option<f64>> = vec![None; way.len()];
    let mut places = Vec::new();
    let mut solver = prepared(scene, asked, way)?;
    let started = Instant::now();
    let known =
        |fastest_us: &[Option<f64>]| -> Vec<f64> { fastest_us.iter().flatten().copied().collect() };
    // The same solver again, which is back outside with the first step: what it does once is not what a step takes.
    'presses: for repeat in 0..REPEATS {
        for (step, at) in way.iter().enumerate() {
            let sample = sample(scene, at, repeat * way.len() + step, asked);
            let began = Instant::now();
            let mut report = solver.step(sample);
            let us = 1e6 * began.elapsed().as_secs_f64();
            if !matches!(report.status, Status::Ok | Status::Behind | Status::Waiting) {
                return Err(format!("a step ends as {}", report.status.name()));
            }
            let touches = is_touching(&report);
            if repeat == 0 && step % STEPS_A_PLACE == 0 {
                if report.status != Status::Ok {
                    report = rest(&mut solver, sample, |_| true)
                        .ok_or("a step finds no balance on it")?;
                }
                places.push(place(&solver, &report));
            }
            if !touches {
                continue;
            }
            let fastest = &mut fastest_us[step];
            *fastest = Some(fastest.map_or(us, |before| before.min(us)));
            let known = known(&fastest_us);
            let least_us = known.iter().copied().fold(f64::INFINITY, f64::min);
            let is_plain = matches!(scene.tissue, Tissue::Registered(_)) && known.len() >= 3;
            let is_sure = is_plain || started.elapsed() > SURE;
            let is_slow = least_us > TOO_SLOW * asked.budget_us;
            if is_sure && (is_slow || started.elapsed() > 3 * TIMED) {
                break 'presses;
            }
        }
        if started.elapsed() > TIMED {
            break;
        }
    }
    let step_us = percentiles(known(&fastest_us));
    let step_us = step_us.ok_or_else(|| "no step in contact found a balance".to_owned())?;
    Ok(Run { step_us, places })
}

fn percentiles(mut us: Vec<f64>) -> Option<StepUs> {
    us.sort_by(f64::total_cmp);
    let at = |share: f64| us.get(((us.len() - 1) as f64 * share).ceil() as usize);
    if us.is_empty() {
        return None;
    }
    Some(StepUs {
        p50: *at(0.5)?,
        p99: *at(0.99)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choice::choose;
    use sutura_host::scene::Document;
    use sutura_shared::wire::message::Fixture;

    const SCENE: &str = r#"
device = "cartesian-bench"
[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [4, 4, 2]
[tissue]
model = "corotational"
youngs_modulus_pa = 10e3
poisson_ratio = 0.4
[[fixed]]
plane = { axis = "z", at_m = -0.03 }
[[tool]]
radius_m = 0.035
[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [
    { time_s = 0.0, position_m = [0.0, 0.0, 0.037] },
    { time_s = 0.4, position_m = [0.001, 0.0, 0.033] },
]
"#;

    /// All that is compared has the scene's own contact law, and the scene is none the worse.
    #[test]
    fn with_rows_only_what_has_them_is_a_candidate() {
        let document = Document::embedded("test.toml", "".as_ref(), SCENE);
        let mut scene = Scene::read(&document, "test").expect("good");
        let before = scene.tissue;
        let plan = Plan {
            device: scene.device.expect("a device").description,
            hand: scene.hand.expect("a hand"),
            host_hz: 100.0,
            seconds: 0.4,
            tick_hz: 1000,
            state_every: 1,
            rendering: Rendering::Rows,
            line_bytes_per_s: 1e6,
            horizon_us: None,
            clear_fault: false,
            fixture: Fixture::None,
        };
        let asked = Asked {
            plan: &plan,
            budget_us: 1e9,
            rendering: Some(Rendering::Rows),
        };
        let candidates = measure(&mut scene, &asked, &mut |_| {}).expect("candidates");
        assert_eq!(scene.tissue, before);
        for candidate in &candidates {
            let tissue = Tissue::named(&candidate.tissue).expect("its name");
            assert_eq!(
                tissue.has_rows(),
                candidate.step_us.is_some(),
                "{candidate:?}"
            );
            // Where little is strained, laws are one.
            let errors = [candidate.error, candidate.displacement_error];
            for error in errors {
                assert_eq!(tissue.has_rows(), error.is_some(), "{candidate:?}");
                assert!((0.0..0.2).contains(&error.unwrap_or(0.0)), "{candidate:?}");
            }
        }
        let (taken, holds) = choose(&candidates, asked.budget_us).expect("one");
        assert!(holds && candidates[taken].error.is_some(), "{candidates:?}");
    }

    #[test]
    fn half_of_the_steps_are_faster_and_a_hundredth_slower() {
        let us = |count: u32| percentiles((0..count).rev().map(f64::from).collect());
        assert_eq!(
            us(201),
            Some(StepUs {
                p50: 100.0,
                p99: 198.0
            })
        );
        // Of few the slowest counts.
        assert_eq!(us(24).map(|us| us.p99), Some(23.0));
        assert_eq!(us(0), None);
    }
}
