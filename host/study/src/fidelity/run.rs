//! One run: console, hand, link and host in step, and the same scene solved every millisecond beside them.
//!
//! Entry point: [`run`]. The console is the real control loop on a simulated plant. Every tick: what has
//! arrived goes in, encoders are read, the command of the tick before begins to act; the host solves for the
//! newest state when its time has come.

use super::around::Blocking;
use super::hand::{Grasp, Motion};
use super::link::{Link, LinkSpec};
use super::plant::{Mechanics, Plant, pace};
use super::scenes::{Sample, Scene, Solution};
use super::stops::Stop;
use super::switches::Mendings;
use sutura_client::Lead;
use sutura_host::session::{Horizon, pack_symmetric, rows_frame};
use sutura_host::step::ToolRows;
use sutura_shared::control::{ContactRows, Control, Fresh, Rendering, TickInput, Tuning};
use sutura_shared::device::DeviceError;
use sutura_shared::link::Companions;
use sutura_shared::wire::message::{Command, Contact, Mode, State};
use sutura_shared::wire::validate::MAX_POSITION;
use sutura_shared::wire::{
    Header, Kind, Message, PROTOCOL_VERSION, Valid, ValidContact, ValidNeedle, ValidRows,
    ValidThread,
};

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
    /// Factor on the tangent and the rows' stiffness that are sent: how wrong they are.
    pub tangent_scale: f64,
    /// Most contact rows in a frame; the console gets none unless it renders them.
    pub most_rows: usize,
    /// \[s\].
    pub seconds: f64,
    /// If any.
    pub knock: Option<Knock>,
    /// What is true at every tick, if it is known: open loop, where the path is.
    pub truth: Option<&'a [True]>,
    /// By what part of its period the host's turns come later, 0 to 1.
    pub phase: f64,
    /// Whether the host starts with nothing computed beforehand.
    pub cold: bool,
    /// How long solves take that block the host; none if its frames always come after the link's delay. Such a host learns
    /// its horizon as sessions do.
    pub blocking: Option<&'a Blocking>,
    /// When the console is told to arm \[s\].
    pub arms_s: f64,
    /// What stops it, and when \[s\].
    pub stop: Option<(f64, Stop)>,
    /// What the host does about its being late.
    pub mendings: Mendings,
}

impl Setup<'_> {
    /// From a state until its frame has been in use for a period: how far rows have to look ahead \[s\].
    fn ahead_s(&self) -> f64 {
        match self.host {
            // As sessions have it.
            Host::Late(spec) if self.blocking.is_some() => 2.0 / spec.host_hz,
            Host::Late(spec) => spec.longest_delay_s() + 1.0 / spec.host_hz,
            Host::Full => 0.0,
        }
    }

    /// Time between two solves as it is planned \[s\].
    fn period_s(&self) -> f64 {
        match self.host {
            Host::Late(spec) => 1.0 / spec.host_hz,
            Host::Full => 1e-3,
        }
    }

    /// Rows that the host has to reduce to.
    fn most_rows_sent(&self) -> usize {
        match (self.host, self.tuning.rendering) {
            (Host::Late(_), Rendering::Rows) => self.most_rows,
            _ => 0,
        }
    }
}

/// What is true in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct True {
    /// Force on the tool \[N\], (3).
    pub force_n: [f64; 3],
    /// Boundaries punctured so far.
    pub punctures: u32,
}

impl True {
    fn of(solution: &Solution) -> Self {
        True {
            force_n: force(solution),
            punctures: solution.punctures,
        }
    }
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
    /// Force that was commanded for the time from this tick to the next, by a console that is as it is described \[N\], (3).
    pub meant_n: [f64; 3],
    /// True force here and now \[N\], (3).
    pub truth_n: [f64; 3],
    /// Boundaries punctured by now, in truth.
    pub punctures: u32,
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
    let mut plant = Plant::new(setup.mechanics, setup.motion, setup.grasp, setup.scene);
    let mut truth = setup
        .truth
        .is_none()
        .then(|| setup.scene.start(0, 0.0, 1e-3));
    let mut host = Remote::new(setup);
    let mut under_way = vec![[0.0; 3]; setup.mechanics.ticks_late()];
    // All that was commanded, as many ticks later as the description says.
    let mut meant = vec![[0.0; 3]; setup.mechanics.actuation_ticks];
    let mut now = True::default();
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
            lead_s: 0.0,
            has_time: true,
        };
        match (setup.truth, &mut truth) {
            (Some(known), _) => now = known.get(number as usize).copied().unwrap_or(now),
            (None, Some(truth)) => {
                if let Some(solution) = truth.solve(&here) {
                    now = True::of(&solution);
                }
            }
            (None, None) => {}
        }
        let is_now = |at_s: f64| number == (at_s * 1e3).round() as u32;
        if is_now(setup.arms_s) {
            control.command(Command::Arm);
        }
        let stop = setup.stop.filter(|(at_s, _)| time_s >= *at_s);
        if setup
            .stop
            .is_some_and(|(at_s, stop)| is_now(at_s) && stop == Stop::Session)
        {
            control.open_session();
        }
        let since_s = stop.map_or(0.0, |(at_s, _)| time_s - at_s);
        let stop = stop.map(|(_, stop)| stop);
        let counts = plant.counts();
        let read_m = counts.map(|count| f64::from(count) / setup.mechanics.counts_per_m);
        let fresh = host.arrives(time_s, &mut control);
        let input = TickInput {
            now_us,
            encoder_counts: Stop::counts(stop, since_s, counts),
            emergency_stop: stop == Some(Stop::Pressed),
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
        meant.push(command_n);
        let asked_n = under_way.remove(0);
        let mut tick = Tick {
            time_s,
            position_m: plant.position_m,
            velocity_m_per_s: plant.velocity_m_per_s,
            acting_n: asked_n,
            command_n,
            meant_n: meant.get(number as usize).copied().unwrap_or_default(),
            truth_n: now.force_n,
            punctures: now.punctures,
            swapped: output.state.contact_sequence != before_sequence,
            energy_j: plant.energy_j,
            mode: output.state.mode,
            faults: output.state.faults,
        };
        before_sequence = output.state.contact_sequence;
        let knock = setup
            .knock
            .filter(|k| (k.from_s..k.until_s).contains(&time_s));
        plant.knock_n = knock.map_or([0.0; 3], |knock| knock.force_n);
        tick.acting_n = plant.advance(&asked_n);
        ticks.push(tick);
    }
    Ok(Record {
        ticks,
        least_energy_j: plant.least_energy_j,
        sent: host.sequence,
    })
}

/// What is true at every tick with a hand that goes where it wants.
pub fn truth_along(scene: &dyn Scene, motion: Motion, seconds: f64) -> Vec<True> {
    let mut truth = scene.start(0, 0.0, 1e-3);
    let mut last = True::default();
    (0..=(seconds * 1e3).round() as u32)
        .map(|number| {
            let time_s = f64::from(number) * 1e-3;
            let sample = Sample {
                time_s,
                position_m: scene.place(motion.at(time_s)),
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: pace(scene, motion, time_s),
                lead_s: 0.0,
                has_time: true,
            };
            if let Some(solution) = truth.solve(&sample) {
                last = True::of(&solution);
            }
            last
        })
        .collect()
}

fn force(solution: &Solution) -> [f64; 3] {
    let [x, y, z, ..] = solution.wrench;
    [x, y, z]
}

/// A frame on the wire.
enum Frame {
    Rows(u32, Box<ContactRows>),
    Needle(ValidNeedle),
    Thread(ValidThread),
    Contact(ValidContact),
}

impl Frame {
    /// Kind, sequence and console time \[us\].
    fn stamp(&self) -> (Kind, u32, u64) {
        match self {
            Frame::Rows(sequence, rows) => (Kind::Rows, *sequence, rows.console_time_us()),
            Frame::Needle(needle) => (Kind::Needle, needle.sequence(), needle.console_time_us()),
            Frame::Thread(thread) => (Kind::Thread, thread.sequence(), thread.console_time_us()),
            Frame::Contact(contact) => {
                (Kind::Contact, contact.sequence(), contact.console_time_us())
            }
        }
    }
}

/// The host and its link.
struct Remote<'a> {
    setup: &'a Setup<'a>,
    tissue: Box<dyn super::scenes::Truth>,
    link: Option<(LinkSpec, Link<Frame>)>,
    /// The last rows that came.
    rows: Box<ContactRows>,
    /// Sequences that the console's end of the link has heard: the newest one, and those that belong together.
    heard: u32,
    companions: Companions,
    /// The next turn, solves so far, and frames.
    turn: u32,
    solves: u32,
    sequence: u32,
    horizon_us: u32,
    /// Of a host that blocks: when it is done \[s\], how many stalls are over, and what it has learnt.
    done_s: f64,
    stalls_over: usize,
    learnt: Horizon,
    /// When its frames usually are in use, and the time of the state before \[s\].
    lead: Lead,
    before_s: Option<f64>,
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
        let (rows, ahead_s, period_s) = (setup.most_rows_sent(), setup.ahead_s(), setup.period_s());
        Remote {
            setup,
            tissue: if setup.cold {
                setup.scene.start_cold(rows, ahead_s, period_s)
            } else {
                setup.scene.start(rows, ahead_s, period_s)
            },
            rows: Box::new(ContactRows::NONE),
            heard: 0,
            companions: Companions::NONE,
            link,
            turn: 0,
            done_s: 0.0,
            stalls_over: 0,
            learnt: setup.mendings.horizon(1.0 / period_s),
            lead: Lead::new(),
            before_s: None,
            solves: 0,
            sequence: 0,
            last_n: [0.0; 3],
            horizon_us: (horizon_s.clamp(HORIZON_S.0, HORIZON_S.1) * 1e6).round() as u32,
        }
    }

    /// What the console finds at the start of a tick: the newest of each kind.
    fn arrives(&mut self, time_s: f64, control: &mut Control) -> Option<Fresh> {
        let (_, link) = self.link.as_mut()?;
        let mut newest = None;
        while let Some(frame) = link.arrived(time_s) {
            let (kind, sequence, time_us) = frame.stamp();
            if sequence <= self.heard {
                continue;
            }
            self.heard = sequence;
            if !self.companions.note(kind, sequence, 0, time_us) {
                continue;
            }
            match frame {
                Frame::Rows(_, rows) => self.rows = rows,
                Frame::Needle(needle) => control.needle(&needle),
                Frame::Thread(thread) => control.thread(&thread),
                Frame::Contact(contact) => {
                    // The console reports it; a tick later the host knows.
                    let age_us = (1e6 * time_s) as u64;
                    let age_us = age_us.saturating_sub(contact.console_time_us());
                    self.learnt.applied(age_us as u32);
                    newest = Some(contact);
                }
            }
        }
        newest.map(|contact| Fresh::of(contact, &self.rows))
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
        self.learnt.tick(
            self.setup
                .mendings
                .console_tick((time_s * 1e3).round() as u32),
        );
        let hz = spec.host_hz;
        let due_s = (f64::from(self.turn) + self.setup.phase) / hz;
        // As if at `due_s`, between this tick and the next.
        if due_s >= time_s + 1e-3 - 1e-9 || time_s < self.done_s {
            return;
        }
        self.turn += 1;
        let sent_s = match self.setup.blocking {
            Some(blocking) => {
                let (own_s, over) = blocking.takes_s(self.solves, self.stalls_over, time_s);
                self.stalls_over = over;
                self.done_s = time_s + own_s;
                // Turns that have passed are left out; the first one is made up for at once.
                let passed = ((time_s + 1e-3) * hz - self.setup.phase).ceil().max(0.0);
                self.turn = self.turn.max(passed as u32);
                self.learnt.took((1e6 * own_s) as u64);
                self.horizon_us = self.learnt.next_us();
                self.done_s
            }
            None => due_s,
        };
        self.solves += 1;
        let before_s = self.before_s.replace(time_s).unwrap_or(time_s);
        let lead_s = self.lead.lead_s(
            state.contact_sequence,
            state.applied_age_us,
            time_s - before_s,
        );
        let sample = Sample {
            time_s,
            position_m: state.position_m.map(f64::from),
            orientation: state.orientation.map(f64::from),
            velocity_m_per_s: state.velocity_m_per_s.map(f64::from),
            lead_s: if self.setup.mendings.ahead {
                lead_s
            } else {
                0.0
            },
            has_time: self.setup.mendings.tries,
        };
        let Some(solution) = self.tissue.solve(&sample) else {
            return;
        };
        let solution = self
            .setup
            .mendings
            .of(solution, &sample, self.setup.ahead_s());
        let frames = self.frames(&sample, now_us, solution);
        if let Some((_, link)) = &mut self.link {
            link.send(sent_s, frames);
        }
    }

    /// What the wire carries of a solution, as the console's rendering asks for; rows, needle and thread before
    /// the contact.
    fn frames(&mut self, sample: &Sample, now_us: u64, solution: Solution) -> Vec<Frame> {
        let rendering = self.setup.tuning.rendering;
        let scale = match rendering {
            Rendering::Hold => 0.0,
            _ => self.setup.tangent_scale,
        };
        let tangent = solution.tangent.map(|row| row.map(|entry| entry * scale));
        let contact = Contact {
            tool: 0,
            position_m: solution
                .position_m
                .unwrap_or(sample.position_m.map(|x| x as f32)),
            orientation: sample.orientation.map(|x| x as f32),
            wrench: solution.wrench.map(|x| x as f32),
            tangent: pack_symmetric(&tangent),
            // As a session has it: where nothing is near the wire has its longest gap.
            gap_m: solution.gap_m.clamp(0.0, f64::from(MAX_POSITION)) as f32,
            normal: solution.normal.map(|x| x as f32),
            relaxation_per_s: 0.0,
            horizon_us: self.horizon_us,
        };
        let mut frames = Vec::with_capacity(4);
        if rendering == Rendering::Rows {
            let rows = solution.rows.map(|rows| stiffer(*rows, scale));
            let rows: Option<ValidRows> = rows
                .and_then(|rows| rows_frame(&rows))
                .and_then(|rows| self.valid(now_us, rows));
            frames.extend(rows.map(|rows| {
                let unpacked = Box::new(ContactRows::unpack(&rows));
                Frame::Rows(rows.sequence(), unpacked)
            }));
            let needle = solution
                .needle
                .and_then(|needle| self.valid(now_us, needle));
            frames.extend(needle.map(Frame::Needle));
            let thread = solution
                .thread
                .and_then(|thread| self.valid(now_us, thread));
            frames.extend(thread.map(Frame::Thread));
        }
        frames.extend(self.valid(now_us, contact).map(Frame::Contact));
        frames
    }

    fn valid<M: Message>(&mut self, console_time_us: u64, body: M) -> Option<Valid<M>> {
        self.sequence += 1;
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: M::KIND,
            session: 1,
            sequence: self.sequence,
            console_time_us,
        };
        Valid::new(header, body).ok()
    }
}

/// Rows of tissue that is so many times stiffer: the same forces at the balance.
fn stiffer(mut rows: ToolRows, times: f64) -> ToolRows {
    if times > 0.0 {
        rows.stiffen(times);
    }
    rows
}
