//! A host whose solves block now and then, in simulated time: what the console renders then, against a solve at every pose.

use super::heard::{Fate, Underway};
use super::horizon::Horizon;
use super::schedule::Schedule;
use super::{LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, Solve};
use crate::link::{Felt, SentContact};
use crate::scene::{Scene, load, position_at};
use std::path::Path;
use sutura_shared::control::{ContactRows, Control, Fresh, TICK_HZ, TickInput};
use sutura_shared::wire::message::{Command, Fixture, Mode, State};
use sutura_shared::wire::{Header, Message, PROTOCOL_VERSION, Valid, ValidContact, ValidRows};
use sutura_study::fidelity::plant::Mechanics;

/// Ticks between two poses at which the truth is solved for.
const TRUTH_EVERY: u64 = 4;
/// One solve in so many stalls.
const STALLS_EVERY: u64 = 100;

/// What came of a run.
struct Outcome {
    decays: Vec<u64>,
    /// Root of the mean square of the force's error, over the largest true force.
    rms: f64,
    longest_ms: f64,
    late: u64,
}

fn scene() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/palpation-frictionless.toml");
    load(&path).expect("a shipped scene")
}

/// Grip at a tick \[m\]: on the hand's path, behind it by what the tissue's resistance would make of it.
fn grip(scene: &Scene, tick: u64) -> [f64; 3] {
    let hand = scene.hand.as_ref().expect("a hand");
    let [x, y, z] = position_at(hand, 1e-3 * tick as f64);
    [x, y, z + 0.25 * (0.014 - z).max(0.0)]
}

pub(super) fn valid<M: Message>(sequence: u32, console_time_us: u64, body: M) -> Valid<M> {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: M::KIND,
        session: 1,
        sequence,
        console_time_us,
    };
    Valid::new(header, body).expect("within the wire's limits")
}

pub(super) fn plan(scene: &Scene, host_hz: f64) -> Plan {
    Plan {
        device: Mechanics::LIGHT.description(),
        hand: scene.hand.expect("a hand"),
        host_hz,
        seconds: scene.seconds,
        tick_hz: TICK_HZ,
        state_every: 1,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
        horizon_us: None,
        clear_fault: false,
        fixture: Fixture::None,
    }
}

fn counts(position_m: [f64; 3]) -> [i32; 3] {
    position_m.map(|x| (x * Mechanics::LIGHT.counts_per_m).round() as i32)
}

/// Every contact state that a console at rest would send from this path.
fn state_at(control: &mut Control, scene: &Scene, tick: u64, fresh: Option<&Fresh>) -> State {
    let input = TickInput {
        now_us: 1000 * tick,
        encoder_counts: counts(grip(scene, tick)),
        ..TickInput::default()
    };
    control.tick(&input, fresh).state
}

/// True force at every [`TRUTH_EVERY`]th pose \[N\].
fn truth(scene: &Scene) -> Vec<[f64; 3]> {
    let mut solver = SceneSolver::new(scene).expect("a solver");
    let ticks = (1e3 * scene.seconds) as u64;
    let mut control = Control::new(Mechanics::LIGHT.description()).expect("a device");
    (0..ticks)
        .step_by(TRUTH_EVERY as usize)
        .map(|tick| {
            let state = state_at(&mut control, scene, tick, None);
            let solved = solver.solve(&valid(1, 1000 * tick, state));
            let wrench = solved.contact.map_or([0.0; 6], |contact| contact.wrench);
            [wrench[0], wrench[1], wrench[2]]
        })
        .collect()
}

fn run(scene: &Scene, truth: &[[f64; 3]], host_hz: f64, stall_ms: u64) -> Outcome {
    let plan = plan(scene, host_hz);
    let mut solver = SceneSolver::for_session(scene, &plan).expect("a solver");
    let mut control = Control::new(plan.device).expect("a device");
    control.command(Command::Arm);
    let mut horizon = Horizon::new(host_hz);
    let mut underway = Underway::default();
    let mut schedule: Option<Schedule> = None;
    // When the frame of the solve under way leaves, and what it was solved for.
    let mut pending: Option<(u64, u64, Felt)> = None;
    let mut arriving: Option<(u64, Fresh)> = None;
    let (mut solves, mut sequence) = (0, 0);
    let mut outcome = Outcome {
        decays: Vec::new(),
        rms: 0.0,
        longest_ms: 0.0,
        late: 0,
    };
    let (mut before, mut square, mut count) = (Mode::Boot, 0.0, 0.0);
    let peak = truth.iter().map(|f| f[2].abs()).fold(0.0, f64::max);
    for tick in 0..(1e3 * scene.seconds) as u64 {
        let fresh = arriving
            .take_if(|(at, _)| *at <= tick)
            .map(|(_, fresh)| fresh);
        let state = state_at(&mut control, scene, tick, fresh.as_ref());
        horizon.tick(state.tick);
        underway.state(1000 * tick, &state, |_, fate| match fate {
            Fate::Used { age_us } => horizon.applied(age_us),
            Fate::TooLate { age_us } => {
                horizon.applied(age_us);
                outcome.late += 1;
            }
            Fate::Lost => {}
        });
        if state.mode == Mode::Decaying && before == Mode::Armed {
            outcome.decays.push(tick);
        }
        before = state.mode;
        if tick % TRUTH_EVERY == 0 {
            let true_n = truth[(tick / TRUTH_EVERY) as usize];
            let off = state.force_n.iter().zip(true_n);
            square += off
                .map(|(felt, n)| (f64::from(*felt) - n).powi(2))
                .sum::<f64>();
            count += 1.0;
        }
        if let Some((_, solved_us, felt)) = pending.take_if(|(leaves, ..)| *leaves <= tick) {
            sequence += 2;
            let rows: Option<ValidRows> =
                felt.rows.map(|rows| valid(sequence - 1, solved_us, rows));
            let rows = rows.map_or(ContactRows::NONE, |rows| ContactRows::unpack(&rows));
            let contact: ValidContact = valid(sequence, solved_us, felt.contact);
            underway.sent(
                SentContact {
                    sequence,
                    console_time_us: solved_us,
                    horizon_us: felt.contact.horizon_us,
                },
                |_, _| {},
            );
            arriving = Some((tick + 1, Fresh::of(contact, &rows)));
        }
        if pending.is_some() || !matches!(state.mode, Mode::Armed | Mode::Decaying) {
            continue;
        }
        let is_due = schedule.as_mut().is_none_or(|plan| plan.is_due(state.tick));
        schedule.get_or_insert_with(|| Schedule::new(state.tick, TICK_HZ, host_hz));
        if is_due {
            solves += 1;
            let stalls = solves % STALLS_EVERY == STALLS_EVERY / 2;
            let took_ms = if stalls { stall_ms } else { 1 };
            let solved = solver.solve(&valid(1, 1000 * tick, state));
            horizon.took(1000 * took_ms);
            let horizon_us = horizon.next_us();
            outcome.longest_ms = outcome.longest_ms.max(1e-3 * f64::from(horizon_us));
            let felt = solved.frames(&state, horizon_us, plan.rendering);
            pending = felt.map(|felt| (tick + took_ms, 1000 * tick, felt));
        }
    }
    outcome.rms = (square / count).sqrt() / peak;
    outcome
}

/// A late host is felt as a late host: once, and then the console has frames that are good for as long.
#[test]
fn stalls_are_met_once_and_then_foreseen() {
    let scene = scene();
    let truth = truth(&scene);
    for host_hz in [60.0, 100.0, 200.0] {
        for stall_ms in [33, 61] {
            let outcome = run(&scene, &truth, host_hz, stall_ms);
            let Outcome {
                decays,
                rms,
                longest_ms,
                late,
            } = &outcome;
            println!(
                "{host_hz} Hz, {stall_ms} ms: {} decays, RMS {:.2} %, horizon up to {longest_ms} ms, {late} late",
                decays.len(),
                1e2 * rms
            );
            assert!(decays.len() <= 1, "{host_hz} Hz, {stall_ms} ms: {decays:?}");
            assert!(*rms <= 0.05, "{host_hz} Hz, {stall_ms} ms: {rms}");
            assert!(*longest_ms <= 150.0);
        }
    }
}

/// What an idle machine does not need is not given.
#[test]
fn a_host_in_time_needs_no_longer_frames() {
    let scene = scene();
    let truth = truth(&scene);
    let outcome = run(&scene, &truth, 200.0, 1);
    assert!(outcome.decays.is_empty() && outcome.late == 0);
    // Eight periods, as long as nothing is known.
    assert!(outcome.longest_ms <= 40.0, "{}", outcome.longest_ms);
    assert!(outcome.rms <= 0.02, "{}", outcome.rms);
}

/// A hand that rests 15 mm above the tissue may be there before the next frame of a slow host, not of a fast one.
#[test]
fn a_hand_that_may_set_out_is_told_of_what_it_may_reach() {
    let scene = scene();
    let told = |host_hz: f64| {
        let plan = plan(&scene, host_hz);
        let mut solver = SceneSolver::for_session(&scene, &plan).expect("a solver");
        let mut control = Control::new(plan.device).expect("a device");
        let mut state = state_at(&mut control, &scene, 0, None);
        state.velocity_m_per_s = [0.0; 3];
        let mut solve = |state: &State, time_us: u64| {
            let solved = solver.solve(&valid(1, time_us, *state));
            let contact = solved.contact.expect("a contact");
            (contact, solved.rows.map_or(0, |rows| rows.count))
        };
        let (far, _) = solve(&state, 1000);
        let down_m = far.gap_m - 15e-3;
        for (at, n) in state.position_m.iter_mut().zip(far.normal) {
            *at -= (n * down_m) as f32;
        }
        let (near, rows) = solve(&state, 6000);
        assert!((near.gap_m - 15e-3).abs() < 1e-3, "{}", near.gap_m);
        (-near.tangent[2][2], rows)
    };
    let (slope, rows) = told(30.0);
    assert!(slope > 10.0 && rows > 0, "{slope} {rows}");
    assert_eq!(told(200.0), (0.0, 0));
}
