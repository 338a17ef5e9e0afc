//! One run: console, hand, link and host in step, and the same scene solved every millisecond beside them.
//!
//! Entry point: [`run`]. The console is the real control loop on a simulated plant. Every tick: what has
//! arrived goes in, encoders are read, the command of the tick before begins to act; the host solves for the
//! newest state when its time has come.

use super::hand::{Grasp, Motion};
use super::link::{Link, LinkSpec};
use super::plant::{Mechanics, Plant};
use super::scenes::{Sample, Scene, Solution};
use crate::session::pack_symmetric;
use sutura_shared::control::{Control, Fresh, Rendering, TickInput, Tuning};
use sutura_shared::device::DeviceError;
use sutura_shared::wire::message::{Command, Contact, Mode, State};
use sutura_shared::wire::{Header, Kind, PROTOCOL_VERSION, ValidContact};

/// Who solves for the console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Host {
    /// A host at the end of a link.
    Late(LinkSpec),
    /// The scene itself, solved in every tick for that tick's encoders: no console's model, no guard. What
    /// a late host is measured against.
    Full,
}

/// A push besides the hand's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knock {
    /// \[s\].
    pub from_s: f64,
    /// \[s\].
    pub until_s: f64,
    /// \[N\], (3).
    pub force_n: [f64; 3],
}

/// What is run.
#[derive(Clone, Copy)]
pub struct Setup<'a> {
    /// What is touched.
    pub scene: &'a dyn Scene,
    /// Where the hand goes.
    pub motion: Motion,
    /// How it holds.
    pub grasp: Grasp,
    /// The console's mechanics.
    pub mechanics: Mechanics,
    /// What the console renders, with which guards.
    pub tuning: Tuning,
    /// Who solves.
    pub host: Host,
    /// Factor on the tangent that is sent: how wrong it is.
    pub tangent_scale: f64,
    /// \[s\].
    pub seconds: f64,
    /// If any.
    pub knock: Option<Knock>,
    /// The true force \[N\] at every tick, if it is known: open loop, where the path is.
    pub truth: Option<&'a [[f64; 3]]>,
}

/// One tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// \[s\].
    pub time_s: f64,
    /// Grip when the encoders were read \[m\], (3), and its velocity \[m/s\], (3).
    pub position_m: [f64; 3],
    /// \[m/s\], (3).
    pub velocity_m_per_s: [f64; 3],
    /// Force that acts from this tick to the next \[N\], (3): an older command.
    pub acting_n: [f64; 3],
    /// Force commanded now \[N\], (3).
    pub command_n: [f64; 3],
    /// True force here and now \[N\], (3).
    pub truth_n: [f64; 3],
    /// Whether a new frame came into use.
    pub swapped: bool,
    /// What the motors had taken from the motion by now, less what they had given \[J\].
    pub energy_j: f64,
    /// Of the console.
    pub mode: Mode,
    /// Of the console.
    pub faults: u16,
}

/// What came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// One per millisecond.
    pub ticks: Vec<Tick>,
    /// Least of the energy that the motors had taken, at any step \[J\].
    pub least_energy_j: f64,
    /// Frames that the host sent.
    pub sent: u32,
}

/// Shortest and longest horizon \[s\]; the console caps as well.
const HORIZON_S: (f64, f64) = (0.020, 0.150);

/// Runs it.
///
/// # Errors
/// The mechanics make no valid device.
pub fn run(setup: &Setup<'_>) -> Result<Record, DeviceError> {
    let description = setup.mechanics.description();
    let mut control = Control::tuned(description, setup.tuning)?;
    control.command(Command::Arm);
    let origin_m = setup.scene.origin_m();
    let mut plant = Plant::new(setup.mechanics, setup.motion, setup.grasp, origin_m);
    let mut truth = setup.truth.is_none().then(|| setup.scene.start());
    let mut host = Remote::new(setup);
    let mut under_way = vec![[0.0; 3]; setup.mechanics.actuation_ticks];
    let mut true_n = [0.0; 3];
    let count = (setup.seconds * 1e3).round() as u32;
    let mut ticks = Vec::with_capacity(count as usize);
    let mut before_sequence = 0;
    for number in 0..count {
        let time_s = f64::from(number) * 1e-3;
        let now_us = u64::from(number) * 1000;
        let here = Sample {
            time_s,
            position_m: plant.position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: plant.velocity_m_per_s,
        };
        match (setup.truth, &mut truth) {
            (Some(known), _) => true_n = known.get(number as usize).copied().unwrap_or(true_n),
            (None, Some(truth)) => {
                if let Some(solution) = truth.solve(&here) {
                    true_n = force(&solution);
                }
            }
            (None, None) => {}
        }
        let counts = plant.counts();
        let read_m = counts.map(|count| f64::from(count) / setup.mechanics.counts_per_m);
        let fresh = host.arrives(time_s);
        let input = TickInput {
            now_us,
            encoder_counts: counts,
            ..TickInput::default()
        };
        let output = control.tick(&input, fresh.as_ref());
        host.sees(time_s, now_us, &output.state);
        let command_n = match setup.host {
            Host::Late(_) => output.current_a.map(|current| 3.75 * f64::from(current)),
            Host::Full => host.force_at(&Sample {
                position_m: read_m,
                ..here
            }),
        };
        under_way.push(command_n);
        let acting_n = under_way.remove(0);
        ticks.push(Tick {
            time_s,
            position_m: plant.position_m,
            velocity_m_per_s: plant.velocity_m_per_s,
            acting_n,
            command_n,
            truth_n: true_n,
            swapped: output.state.contact_sequence != before_sequence,
            energy_j: plant.energy_j,
            mode: output.state.mode,
            faults: output.state.faults,
        });
        before_sequence = output.state.contact_sequence;
        let knock = setup
            .knock
            .filter(|k| (k.from_s..k.until_s).contains(&time_s));
        plant.knock_n = knock.map_or([0.0; 3], |knock| knock.force_n);
        plant.advance(&acting_n);
    }
    Ok(Record {
        ticks,
        least_energy_j: plant.least_energy_j,
        sent: host.sequence,
    })
}

/// The true force at every tick of a hand that goes where it wants \[N\], (3).
pub fn truth_along(scene: &dyn Scene, motion: Motion, seconds: f64) -> Vec<[f64; 3]> {
    let mut truth = scene.start();
    let mut last = [0.0; 3];
    let origin = scene.origin_m();
    (0..=(seconds * 1e3).round() as u32)
        .map(|number| {
            let time_s = f64::from(number) * 1e-3;
            let way = motion.at(time_s);
            let sample = Sample {
                time_s,
                position_m: [0, 1, 2].map(|axis: usize| origin[axis] + way[axis]),
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: motion.velocity(time_s),
            };
            if let Some(solution) = truth.solve(&sample) {
                last = force(&solution);
            }
            last
        })
        .collect()
}

fn force(solution: &Solution) -> [f64; 3] {
    let [x, y, z, ..] = solution.wrench;
    [x, y, z]
}

/// The host and its link.
struct Remote<'a> {
    setup: &'a Setup<'a>,
    tissue: Box<dyn super::scenes::Truth>,
    link: Option<(LinkSpec, Link<Fresh>)>,
    /// Solves so far, and frames.
    solves: u32,
    sequence: u32,
    horizon_us: u32,
    /// The last force of a full solve \[N\], (3).
    last_n: [f64; 3],
}

impl<'a> Remote<'a> {
    fn new(setup: &'a Setup<'a>) -> Self {
        let (link, horizon_s) = match setup.host {
            Host::Late(spec) => {
                let periods = 3.0 / spec.host_hz + spec.longest_delay_s();
                (Some((spec, Link::new(spec))), periods)
            }
            Host::Full => (None, 0.0),
        };
        Remote {
            setup,
            tissue: setup.scene.start(),
            link,
            solves: 0,
            sequence: 0,
            last_n: [0.0; 3],
            horizon_us: (horizon_s.clamp(HORIZON_S.0, HORIZON_S.1) * 1e6).round() as u32,
        }
    }

    /// What the console finds at the start of a tick.
    fn arrives(&mut self, time_s: f64) -> Option<Fresh> {
        self.link.as_mut()?.1.arrived(time_s)
    }

    /// The force itself, as motors that do not give way at once have it.
    fn force_at(&mut self, sample: &Sample) -> [f64; 3] {
        if let Some(solution) = self.tissue.solve(sample) {
            let limit = f64::from(self.setup.mechanics.description().max_force_n);
            self.last_n = force(&solution).map(|force| force.clamp(-limit, limit));
        }
        self.last_n
    }

    /// Solves for this state if it is time, and sends.
    fn sees(&mut self, time_s: f64, now_us: u64, state: &State) {
        let Some((spec, _)) = &self.link else {
            return;
        };
        let due_s = f64::from(self.solves) / spec.host_hz;
        // As if at `due_s`, between this tick and the next.
        if due_s >= time_s + 1e-3 - 1e-9 {
            return;
        }
        self.solves += 1;
        let sample = Sample {
            time_s,
            position_m: state.position_m.map(f64::from),
            orientation: state.orientation.map(f64::from),
            velocity_m_per_s: state.velocity_m_per_s.map(f64::from),
        };
        let frame = self.solve(&sample, now_us);
        if let (Some(frame), Some((_, link))) = (frame, &mut self.link) {
            link.send(due_s, frame);
        }
    }

    /// Solves; nothing where the solver has nothing, or nothing that a console would take.
    fn solve(&mut self, sample: &Sample, now_us: u64) -> Option<Fresh> {
        let solution = self.tissue.solve(sample)?;
        self.sequence += 1;
        let holds = self.setup.tuning.rendering == Rendering::Hold;
        let scale = if holds { 0.0 } else { self.setup.tangent_scale };
        let tangent = solution.tangent.map(|row| row.map(|entry| entry * scale));
        let contact = Contact {
            tool: 0,
            position_m: sample.position_m.map(|x| x as f32),
            orientation: sample.orientation.map(|x| x as f32),
            wrench: solution.wrench.map(|x| x as f32),
            tangent: pack_symmetric(&tangent),
            gap_m: solution.gap_m as f32,
            normal: solution.normal.map(|x| x as f32),
            relaxation_per_s: if holds {
                0.0
            } else {
                solution.relaxation_per_s as f32
            },
            horizon_us: self.horizon_us,
        };
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Kind::Contact,
            session: 1,
            sequence: self.sequence,
            console_time_us: now_us,
        };
        ValidContact::new(header, contact).ok().map(Fresh::from)
    }
}
