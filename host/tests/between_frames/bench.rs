//! A host that is late, a console that goes on by itself, and the truth: the same scene solved every millisecond.

use nalgebra::Vector3;
use std::io::Write;
use std::path::Path;
use sutura_host::scene::{Document, Scene};
use sutura_host::session::{Rendering as Told, Solve, Solved, TissueSolver};
use sutura_host::step::Status;
use sutura_shared::control::{LocalNeedle, LocalThread};
use sutura_shared::wire::message::{Contact, Mode, State};
use sutura_shared::wire::{Header, Kind, Message, PROTOCOL_VERSION, Valid};

/// What the console has of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rendering {
    Hold,
    Tangent,
    /// Tangent, needle and thread.
    Local,
}

/// Of one run, in parts of the largest true force.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    pub largest_n: f64,
    pub rms: f64,
    pub peak: f64,
    /// Largest jump of the force at a frame, less the true one.
    pub step: f64,
    pub punctures: usize,
    /// 95th percentile and largest of how far a puncture is off \[ms\].
    pub late_p95_ms: f64,
    pub late_max_ms: f64,
    pub peak_at_s: f64,
}

/// A shipped scene, with `from` in its file replaced.
pub fn scene(name: &str, from: &str, to: &str) -> Scene {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let text = std::fs::read_to_string(root.join("scenes").join(name)).unwrap();
    assert!(text.contains(from));
    let document = Document::embedded("a scene", &root.join("scenes"), &text.replace(from, to));
    Scene::read(&document, "a scene").unwrap()
}

fn header(kind: Kind, sequence: u32, console_time_us: u64) -> Header {
    Header {
        version: PROTOCOL_VERSION,
        kind,
        session: 1,
        sequence,
        console_time_us,
    }
}

fn valid<M: Message>(sequence: u32, time_us: u64, body: M) -> Valid<M> {
    Valid::new(header(M::KIND, sequence, time_us), body).unwrap()
}

/// Where a path is at a time \[s\], and how fast \[m, m/s\].
pub type Hand<'a> = &'a dyn Fn(f64) -> Vector3<f64>;

fn state(hand: Hand, tick: u64) -> Valid<State> {
    let time_s = 1e-3 * tick as f64;
    let velocity = (hand(time_s) - hand(time_s - 1e-3)) / 1e-3;
    let body = State {
        tick: tick as u32,
        position_m: hand(time_s).map(|x| x as f32).into(),
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: velocity.map(|x| x as f32).into(),
        force_n: [0.0; 3],
        current_a: [0.0; 3],
        mode: Mode::Armed,
        faults: 0,
        contact_sequence: 0,
        contact_age_us: 0,
        applied_age_us: 0,
        trace_hash: 0,
    };
    valid(tick as u32 + 1, 1000 * tick, body)
}

fn punctures(solver: &TissueSolver) -> u64 {
    u64::from(solver.punctures())
}

/// A solver that has come so far, a step every 5 ms.
fn begin(scene: &Scene, hand: Hand, start: u64) -> TissueSolver {
    let mut solver = TissueSolver::new(scene).unwrap();
    // The tool takes a needle where the scene's hand begins.
    let first = scene.hand.as_ref().unwrap().way_points[0].position_m;
    let there = Vector3::from(first).map(f64::from);
    solver.solve(&state(&|_| there, 0));
    for tick in (0..start).step_by(5) {
        solver.solve(&state(hand, tick));
    }
    solver
}

/// The truth at every tick: force \[N\], and punctures so far.
pub fn truth(scene: &Scene, hand: Hand, start: u64, ticks: u64) -> Vec<(Vector3<f64>, u64)> {
    let mut solver = begin(scene, hand, start);
    let each = (start..ticks).map(|tick| {
        let solved = solver.solve(&state(hand, tick));
        assert_eq!(solved.status, Status::Ok, "tick {tick}");
        let [x, y, z, ..] = solved.contact.unwrap().wrench;
        (Vector3::new(x, y, z), punctures(&solver))
    });
    each.collect()
}

struct Console {
    contact: Option<(u64, Contact)>,
    needle: Option<LocalNeedle>,
    thread: Option<LocalThread>,
    offset: Vector3<f64>,
}

/// Upper triangle by rows, times dx, the first three rows.
fn linear(contact: &Contact, dx: &[f32; 6]) -> Vector3<f64> {
    let mut matrix = [[0.0; 6]; 6];
    let mut entries = contact.tangent.iter();
    for row in 0..6 {
        for column in row..6 {
            let entry = *entries.next().unwrap();
            matrix[row][column] = entry;
            matrix[column][row] = entry;
        }
    }
    let part = |row: usize| {
        let sum: f32 = matrix[row].iter().zip(dx).map(|(k, x)| k * x).sum();
        f64::from(contact.wrench[row] + sum)
    };
    Vector3::new(part(0), part(1), part(2))
}

impl Console {
    /// Force at a pose, without the blend.
    fn force(&mut self, at: &Vector3<f64>, now_us: u64, rendering: Rendering) -> Vector3<f64> {
        let Some((solved_us, contact)) = &self.contact else {
            return Vector3::zeros();
        };
        let from = contact.position_m;
        let dx = [
            at.x as f32 - from[0],
            at.y as f32 - from[1],
            at.z as f32 - from[2],
            0.0,
            0.0,
            0.0,
        ];
        if rendering == Rendering::Hold {
            return linear(contact, &[0.0; 6]);
        }
        let mut force = linear(contact, &dx);
        if rendering == Rendering::Local {
            if let Some(needle) = self.needle.as_mut().filter(|n| n.solved_us() == *solved_us) {
                let [x, y, z, ..] = needle.correction(&dx, now_us);
                force += Vector3::new(x, y, z).map(f64::from);
            }
            if let Some(thread) = self.thread.as_mut().filter(|t| t.solved_us() == *solved_us) {
                let [x, y, z, ..] = thread.correction(&dx, now_us);
                force += Vector3::new(x, y, z).map(f64::from);
            }
        } else if force.dot(&Vector3::from(contact.normal).map(f64::from)) < 0.0
            || contact.gap_m > 0.0
        {
            force = Vector3::zeros();
        }
        force
    }
}

/// A session of a host with this period and one period of delay, beside the truth.
pub fn run(
    scene: &Scene,
    hand: Hand,
    truth: &[(Vector3<f64>, u64)],
    start: u64,
    host_hz: f64,
    rendering: Rendering,
    mut dump: Option<std::fs::File>,
    mut trace: impl FnMut(u64, Vector3<f64>, Vector3<f64>),
) -> Outcome {
    let mut solver = begin(scene, hand, start);
    let mut console = Console {
        contact: None,
        needle: None,
        thread: None,
        offset: Vector3::zeros(),
    };
    let period_ms = 1e3 / host_hz;
    let mut frames: Vec<(f64, u64, Solved)> = Vec::new();
    let mut next_ms = start as f64;
    let mut had: Vec<u64> = Vec::new();
    let mut host_knows = 0;
    let (mut errors, mut before) = (Vec::new(), (Vector3::zeros(), Vector3::zeros()));
    let mut outcome = Outcome {
        largest_n: truth
            .iter()
            .map(|(force, _)| force.norm())
            .fold(0.0, f64::max),
        ..Outcome::default()
    };
    let when: Vec<u64> = (1..truth.len())
        .filter(|tick| truth[*tick].1 > truth[tick - 1].1)
        .map(|tick| tick as u64 + start)
        .collect();
    for (tick, (should, _)) in (start..).zip(truth) {
        let (now_us, at) = (1000 * tick, hand(1e-3 * tick as f64));
        if tick as f64 >= next_ms {
            let solved = solver.solve(&state(hand, tick));
            frames.push((next_ms + period_ms, tick, solved));
            next_ms += period_ms;
            let knows = punctures(&solver);
            if knows > host_knows {
                host_knows = knows;
                frames.last_mut().unwrap().2.status = Status::Behind;
            }
        }
        let mut swapped = false;
        if frames
            .first()
            .is_some_and(|(at_ms, ..)| tick as f64 >= *at_ms)
        {
            let (_, solved_tick, solved) = frames.remove(0);
            let told = state(hand, solved_tick);
            let felt = solved.frames(told.body(), 100_000, Told::Rows).unwrap();
            if let Some(file) = &mut dump {
                let line = serde_json::json!({
                    "now": tick, "solved": solved_tick, "contact": felt.contact, "needle": felt.needle,
                    "thread": felt.thread, "punctured": solved.status == Status::Behind,
                });
                writeln!(file, "{line}").unwrap();
            }
            let old = console.force(&at, now_us, rendering);
            let solved_us = 1000 * solved_tick;
            let sequence = solved_tick as u32 + 1;
            let mut needle = felt
                .needle
                .map(|needle| LocalNeedle::new(&valid(sequence, solved_us, needle)));
            if let (Some(new), Some(old)) = (&mut needle, &console.needle) {
                new.adopt(old);
            }
            // The host has had it in this frame, and the console not yet.
            if solved.status == Status::Behind
                && had
                    .last()
                    .is_none_or(|had| *had < solved_us.saturating_sub(40_000))
            {
                had.push(now_us);
            }
            console.needle = needle;
            console.thread = felt
                .thread
                .map(|thread| LocalThread::new(&valid(sequence, solved_us, thread)));
            console.contact = Some((solved_us, felt.contact));
            let new = console.force(&at, now_us, rendering);
            console.offset += old - new;
            swapped = true;
        }
        let force = console.force(&at, now_us, rendering);
        if let Some(at_us) = console.needle.as_ref().and_then(LocalNeedle::punctured_us)
            && rendering == Rendering::Local
            && had.last().is_none_or(|had| at_us > had + 40_000)
        {
            had.push(at_us);
        }
        console.offset *= 0.904_837_4;
        let force = force + console.offset;
        trace(tick, *should, force);
        let error = (force - should).norm();
        let near = when.iter().any(|at| at.abs_diff(tick) <= 20);
        if !near {
            errors.push(error);
            if error > outcome.peak {
                (outcome.peak, outcome.peak_at_s) = (error, 1e-3 * tick as f64);
            }
            if swapped {
                let step = ((force - before.0) - (should - before.1)).norm();
                outcome.step = outcome.step.max(step);
            }
        }
        before = (force, *should);
    }
    outcome.punctures = when.len();
    let mut late: Vec<f64> = when
        .iter()
        .map(|at| {
            let nearest = had.iter().map(|had| (*had as f64 / 1e3 - *at as f64).abs());
            nearest.fold(f64::MAX, f64::min)
        })
        .collect();
    late.sort_by(f64::total_cmp);
    if let Some(most) = late.last() {
        outcome.late_max_ms = *most;
        outcome.late_p95_ms =
            late[((late.len() as f64 * 0.95).ceil() as usize - 1).min(late.len() - 1)];
    }
    let squares: f64 = errors.iter().map(|error| error * error).sum();
    outcome.rms = (squares / errors.len() as f64).sqrt() / outcome.largest_n;
    outcome.peak /= outcome.largest_n;
    outcome.step /= outcome.largest_n;
    outcome
}

/// Name, hand, first tick and last one.
pub type Case<'a> = (&'a str, Hand<'a>, u64, u64);

/// Prints the errors of every rendering and rate, and writes truth, frames and forces into the directory `TRACES`.
pub fn table(scene: &Scene, hands: &[Case]) {
    let dir = std::env::var("TRACES").ok();
    for (name, hand, start, end) in hands {
        let truth = truth(scene, hand, *start, *end);
        if let Some(dir) = &dir {
            let lines = (*start..).zip(&truth).map(|(tick, (force, punctures))| {
                let at = hand(1e-3 * tick as f64);
                let numbers = [at.x, at.y, at.z, force.x, force.y, force.z];
                format!(
                    "{tick} {} {punctures}\n",
                    numbers.map(|x| x.to_string()).join(" ")
                )
            });
            std::fs::write(format!("{dir}/{name}-truth"), lines.collect::<String>()).unwrap();
        }
        for host_hz in [30.0, 60.0, 100.0, 200.0] {
            for rendering in [Rendering::Hold, Rendering::Tangent, Rendering::Local] {
                let file = |what: &str| {
                    dir.as_ref()
                        .map(|dir| format!("{dir}/{name}-{host_hz}-{what}"))
                };
                let frames = file("frames").filter(|_| rendering == Rendering::Local);
                let frames = frames.map(|path| std::fs::File::create(path).unwrap());
                let mut lines = String::new();
                let found = run(
                    scene,
                    hand,
                    &truth,
                    *start,
                    host_hz,
                    rendering,
                    frames,
                    |tick, should, is| {
                        lines +=
                            &format!("{tick} {} {} {}\n", should.z, is.z, (is - should).norm());
                    },
                );
                if let Some(path) = file(&format!("{rendering:?}")) {
                    std::fs::write(path, lines).unwrap();
                }
                println!(
                    "{name:8} {host_hz:5} Hz {rendering:8?} rms {:6.2} % peak {:6.2} % (at {:.3} s) step {:6.2} %  {} punctures late p95 {:.1} max {:.1} ms  of {:.3} N",
                    100.0 * found.rms,
                    100.0 * found.peak,
                    found.peak_at_s,
                    100.0 * found.step,
                    found.punctures,
                    found.late_p95_ms,
                    found.late_max_ms,
                    found.largest_n
                );
            }
        }
    }
}
