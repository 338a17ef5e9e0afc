//! What each model costs on this machine, and how far off it is, on the scene's own mesh under its own tool.
//!
//! Entry point: [`measure`]. Time is that of the session's solver with what the console is to render from. For the error
//! every model is given what the reference's tool holds: then what differs is the model, not who sticks where.

use super::way::Press;
use super::{Candidate, SAFE_SHARE, StepUs};
use crate::scene::{Corotational, Pose, Registered, Scene, Tissue, models};
use crate::script::Path;
use crate::session::{ModelSolver, Plan, Rendering, TissueSolver};
use crate::step::Status;
use crate::tool::ToolSample;
use crate::tradeoff::registry::entry;
use nalgebra::Vector3;
use std::time::{Duration, Instant};
use sutura_models::{Drive, Outcome};

/// Steps of the press that are timed, and how many of them lie between two places at which forces are compared.
const STEPS: usize = 24;
const STEPS_A_PLACE: usize = 6;
/// Repetitions of the timed press, and how long one candidate may take for them; three times as long for the first.
const REPEATS: usize = 3;
const TIMED: Duration = Duration::from_millis(500);
/// After this the reference goes no deeper.
const LONGEST_REFERENCE: Duration = Duration::from_secs(3);
/// So long after the reference no other model is timed, or none compared: whoever asks is waiting.
const LONGEST_TIMED: Duration = Duration::from_secs(5);
const LONGEST: Duration = Duration::from_secs(7);
/// Slower than this share of the budget is too slow even on a machine that is busy with other things; known from three steps of
/// models that prepare nothing in their first ones, else after so much time.
const TOO_SLOW: f64 = 2.0 * SAFE_SHARE;
const SURE: Duration = Duration::from_millis(400);
const SLOW: &str = "too slow";
/// The reference: neo-Hookean, balanced by Newton's method. It is a candidate itself, timed where forces are compared.
const REFERENCE: (&str, &str) = ("hyperelastic", "linear cells, to 1e-3");
/// Passes of a corotational step in a session, and the registry's setting that goes as far.
const COROTATIONAL: [(u32, &str); 2] = [
    (1, "1 solve, factor at 0.1 rad"),
    (4, "4 solves, factor at 0.1 rad"),
];

const NO_TIME: &str = "not measured: no time left";

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

    /// What the reference is timed with.
    fn without_rows(&self) -> Rendering {
        match self.rendering {
            Some(Rendering::Hold) => Rendering::Hold,
            _ => Rendering::Tangent,
        }
    }
}

/// What the reference's tool holds at a place, and what comes of it.
struct Place {
    held: Vec<(u32, [f64; 3])>,
    rows: Vec<usize>,
    force: Vector3<f64>,
    positions_m: Vec<[f64; 3]>,
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
    let (with_rows, others): (Vec<_>, Vec<_>) = all(scene.tissue)
        .into_iter()
        .partition(|(tissue, _)| tissue.has_rows());
    // These are there for any scene, so that something is known whatever the reference takes.
    let mut candidates: Vec<_> = with_rows
        .into_iter()
        .map(|own| (timed(scene, asked, &way, own.0, told), own.1))
        .collect();
    told("the reference");
    let (reference, reference_us) = reference(scene, asked, &press.places(STEPS / STEPS_A_PLACE))?;
    let began = Instant::now();
    for (tissue, model) in others {
        let candidate = if asked.rendering == Some(Rendering::Rows) {
            Candidate {
                note: "gives no rows".to_owned(),
                ..Candidate::of(tissue)
            }
        } else if is_reference(model) {
            let candidate = Candidate {
                step_us: reference_us,
                error: Some(0.0),
                displacement_error: Some(0.0),
                ..Candidate::of(tissue)
            };
            candidate.judged(asked.budget_us)
        } else if began.elapsed() > LONGEST_TIMED {
            Candidate {
                note: NO_TIME.to_owned(),
                ..Candidate::of(tissue)
            }
        } else {
            timed(scene, asked, &way, tissue, told)
        };
        candidates.push((candidate, model));
    }
    for (candidate, model) in &mut candidates {
        if !candidate.note.is_empty() || candidate.error.is_some() {
            continue;
        }
        told(&format!("error of {}", candidate.tissue));
        if began.elapsed() > LONGEST {
            candidate.note = NO_TIME.to_owned();
        } else if let Err(why) = compare(scene, asked, *model, &reference, candidate) {
            candidate.fail(why);
        }
    }
    Ok(candidates
        .into_iter()
        .map(|(candidate, _)| candidate)
        .collect())
}

/// A candidate with its time, and whether that is far too much; or why it has none.
fn timed(
    scene: &mut Scene,
    asked: &Asked<'_>,
    way: &[[f64; 3]],
    tissue: Tissue,
    told: &mut dyn FnMut(&str),
) -> Candidate {
    told(&format!("time of {tissue}"));
    scene.tissue = tissue;
    let mut candidate = Candidate::of(tissue);
    match run(scene, asked, way) {
        Ok(step_us) => {
            candidate.step_us = Some(step_us);
            candidate.judged(asked.budget_us)
        }
        Err(why) => {
            candidate.fail(why);
            candidate
        }
    }
}

impl Candidate {
    /// Says so where it is too slow to be compared.
    fn judged(mut self, budget_us: f64) -> Self {
        let most = TOO_SLOW * budget_us;
        if self.step_us.is_some_and(|step_us| step_us.p50 > most) {
            self.note = SLOW.to_owned();
        }
        self
    }

    /// It cannot be taken.
    fn fail(&mut self, why: String) {
        self.step_us = None;
        self.note = why;
    }
}

/// Models as sessions have them, each with what it is compared by: first those that are quick on most meshes, so that what
/// there is no time for would hardly hold a budget. Corotational tissue keeps the scene's own settings.
fn all(scenes: Tissue) -> Vec<(Tissue, Registered)> {
    let registered = |name: &str, setting: &str| Registered::new(name, Some(setting)).ok();
    let mut all: Vec<(Tissue, Registered)> = Vec::new();
    if let Some(linear) = registered("linear", "") {
        all.push((Tissue::Linear, linear));
    }
    for (passes, setting) in COROTATIONAL {
        let tissue = Tissue::Corotational(Corotational {
            passes: Some(passes),
            ..Corotational::default()
        });
        let model = registered("corotational", setting);
        all.extend(model.map(|model| (tissue.instead_of(scenes), model)));
    }
    for entry in models().into_iter().rev() {
        if matches!(entry.tissue, "linear" | "corotational") {
            continue;
        }
        for setting in entry.settings.iter().filter(|setting| setting.short) {
            let model = registered(entry.tissue, &setting.name);
            all.extend(model.map(|model| (Tissue::Registered(model), model)));
        }
    }
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

fn is_reference(model: Registered) -> bool {
    let (name, setting) = REFERENCE;
    Registered::new(name, Some(setting)) == Ok(model)
}

/// The reference's answers along the way, and how long its steps in contact take.
fn reference(
    scene: &Scene,
    asked: &Asked<'_>,
    way: &[[f64; 3]],
) -> Result<(Vec<Place>, Option<StepUs>), String> {
    let (name, setting) = REFERENCE;
    let model = Registered::new(name, Some(setting))?;
    let mut solver = ModelSolver::new(scene, model, asked.without_rows(), asked.plan.host_hz)
        .map_err(|error| error.to_string())?;
    let started = Instant::now();
    let (mut places, mut us) = (Vec::new(), Vec::new());
    for (step, at) in way.iter().enumerate() {
        let began = Instant::now();
        let (status, contacts, _) = solver.step(sample(scene, at, step, asked));
        let contact = contacts.first().copied().unwrap_or_default();
        if status != Status::Ok {
            // As far as there is an answer.
            break;
        }
        if contact.rows > 0 {
            us.push(1e6 * began.elapsed().as_secs_f64());
            let (held, rows) = solver.held();
            places.push(Place {
                held: held.to_vec(),
                rows: rows.to_vec(),
                force: -Vector3::from_column_slice(&contact.wrench[..3]),
                positions_m: solver.positions_m().to_vec(),
            });
            if started.elapsed() > LONGEST_REFERENCE {
                break;
            }
        }
    }
    if places.is_empty() {
        return Err("the reference finds no balance on it".to_owned());
    }
    Ok((places, percentiles(us)))
}

/// A session's solver that only has to be quick.
enum Timed {
    Rows(Box<TissueSolver>),
    Model(Box<ModelSolver>),
}

impl Timed {
    fn new(scene: &Scene, asked: &Asked<'_>, way: &[[f64; 3]]) -> Result<Self, String> {
        let plan = asked.plan(scene.tissue);
        if let Tissue::Registered(model) = scene.tissue {
            let solver = ModelSolver::new(scene, model, plan.rendering, plan.host_hz);
            let solver = solver.map_err(|error| error.to_string())?;
            return Ok(Timed::Model(Box::new(solver)));
        }
        let mut solver = TissueSolver::new(scene).map_err(|error| error.to_string())?;
        // As a session is prepared for its hand.
        let grips = way.iter().map(|position_m| Pose {
            position_m: *position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
        });
        solver.prepare(&Path {
            grips: grips.collect(),
            needles: Vec::new(),
        });
        solver.reduce_to(plan.most_rows(), 2.0 / plan.host_hz);
        Ok(Timed::Rows(Box::new(solver)))
    }

    /// How a step ended, and whether it touched.
    fn step(&mut self, sample: ToolSample) -> (Status, bool) {
        match self {
            Timed::Rows(solver) => {
                let report = solver.step(sample);
                let driven = report.contacts().first();
                (
                    report.status,
                    driven.is_some_and(|contact| contact.rows > 0),
                )
            }
            Timed::Model(solver) => {
                let (status, contacts, _) = solver.step(sample);
                (
                    status,
                    contacts.first().is_some_and(|contact| contact.rows > 0),
                )
            }
        }
    }
}

/// Times the press; what is far too slow only as far as to know that.
fn run(scene: &Scene, asked: &Asked<'_>, way: &[[f64; 3]]) -> Result<StepUs, String> {
    let mut fastest_us: Vec<Option<f64>> = vec![None; way.len()];
    let mut solver = Timed::new(scene, asked, way)?;
    let started = Instant::now();
    let known =
        |fastest_us: &[Option<f64>]| -> Vec<f64> { fastest_us.iter().flatten().copied().collect() };
    // The same solver again, which is back outside with the first step: what it does once is not what a step takes.
    'presses: for repeat in 0..REPEATS {
        for (step, at) in way.iter().enumerate() {
            let sample = sample(scene, at, repeat * way.len() + step, asked);
            let began = Instant::now();
            let (status, touches) = solver.step(sample);
            let us = 1e6 * began.elapsed().as_secs_f64();
            if !matches!(status, Status::Ok | Status::Behind | Status::Waiting) {
                return Err(format!("a step ends as {}", status.name()));
            }
            if !touches {
                continue;
            }
            let fastest = &mut fastest_us[step];
            *fastest = Some(fastest.map_or(us, |before| before.min(us)));
            let known = known(&fastest_us);
            let least_us = known.iter().copied().fold(f64::INFINITY, f64::min);
            let is_plain = matches!(solver, Timed::Model(_)) && known.len() >= 3;
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
    percentiles(known(&fastest_us)).ok_or_else(|| "no step in contact found a balance".to_owned())
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

/// Force and displacement where the reference's tool holds what it holds.
fn compare(
    scene: &Scene,
    asked: &Asked<'_>,
    model: Registered,
    reference: &[Place],
    candidate: &mut Candidate,
) -> Result<(), String> {
    let mut tissue = model.build(&scene.body(), &scene.mesh)?;
    let force_n = scene.node_forces();
    let moves = entry(model.name()).is_some_and(|entry| entry.has_step);
    let (mut off, mut largest) = (0.0, 0.0_f64);
    let (mut apart, mut moved) = (0.0, 0.0);
    for place in reference {
        let drive = Drive {
            held: &place.held,
            force_n: &force_n,
        };
        // As many steps as a session has on the way there, unless there is nothing left to do.
        for _ in 0..STEPS_A_PLACE {
            match tissue.step(&drive, 1.0 / asked.plan.host_hz).outcome {
                Outcome::Converged if !moves => break,
                Outcome::Converged | Outcome::Unfinished => {}
                Outcome::Failed(why) => return Err(why.to_owned()),
            }
        }
        let reactions = tissue.reactions_n();
        let rows = place.rows.iter().filter_map(|row| reactions.get(*row));
        let force: Vector3<f64> = rows.map(|force| Vector3::from(*force)).sum();
        off += (force - place.force).norm_squared();
        largest = largest.max(place.force.norm());
        let nodes = tissue.positions_m().iter().zip(&place.positions_m);
        for ((here, there), rest) in nodes.zip(scene.mesh.points_m()) {
            apart += (Vector3::from(*here) - Vector3::from(*there)).norm_squared();
            moved += (Vector3::from(*there) - Vector3::from(*rest)).norm_squared();
        }
    }
    candidate.error = Some((off / reference.len() as f64).sqrt() / largest);
    candidate.displacement_error = Some(f64::sqrt(apart / moved));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choice::choose;
    use crate::scene::Document;
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

    /// A session with rows is offered what has them, compared as ever; and the scene is none the worse.
    #[test]
    fn with_rows_only_what_has_them_is_a_candidate() {
        let document = Document::embedded("test.toml", "".as_ref(), SCENE);
        let mut scene = Scene::read(&document, "test").expect("good");
        let before = scene.tissue;
        let plan = Plan {
            device: scene.device.expect("a device"),
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
            for error in errors.into_iter().flatten() {
                assert!(
                    tissue.has_rows() && 0.0 < error && error < 0.2,
                    "{candidate:?}"
                );
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
