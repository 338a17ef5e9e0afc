//! How stiff tissue that is not linear is on the way that a hand is about to go, instead of where it is: a step at its end,
//! which is thrown away.
//!
//! Entry points: [`SceneSolver::secant`], [`stiffen`]. What the console would make of rows there is asked of the console's
//! own solver; along the normal alone, for across it rows are solved ahead already.

use super::super::look_budget::Ahead;
use super::super::{Effort, Goal, rows_frame};
use super::SceneSolver;
use crate::step::{Status, StepOptions, ToolContact, ToolRows};
use nalgebra::Vector3;
use sutura_shared::control::ContactRows;
use sutura_shared::wire::message::Rows;
use sutura_shared::wire::{Header, Message, PROTOCOL_VERSION, Valid};

/// Part of the way to where the grip may get while a frame is in use: the middle of that time, for frames are in use for its
/// second half.
const MIDDLE: f64 = 0.75;
/// Longest way, in radii of the tool: a step follows farther, but not at once.
const MOST_RADII: f64 = 0.5;
/// A tool that comes out is tried where this part of its force is left.
const LEFT: f64 = 0.2;
const MOST_HALVINGS: u32 = 4;
/// Less change of force than this says nothing \[N\].
const LEAST_N: f64 = 0.02;
/// Rows solve as often as a console does in so many ticks.
const TICKS: u32 = 8;
/// So many times softer or stiffer at most.
const MOST: f64 = 2.0;

/// A console that has rows.
struct Console {
    rows: Box<ContactRows>,
    normal: Vector3<f64>,
}

impl Console {
    fn with(rows: &ToolRows, normal: Vector3<f64>) -> Option<Self> {
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Rows::KIND,
            session: 0,
            sequence: 0,
            console_time_us: 0,
        };
        let frame = Valid::new(header, rows_frame(rows)?).ok()?;
        Some(Self {
            rows: Box::new(ContactRows::unpack(&frame)),
            normal,
        })
    }

    /// Change of the force along the normal after a way along it \[m\]; \[N\].
    fn change_n(&mut self, way_m: f64) -> f64 {
        let [x, y, z] = (self.normal * way_m).into();
        let moved = [x as f32, y as f32, z as f32, 0.0, 0.0, 0.0];
        let mut change = [0.0; 6];
        for _ in 0..TICKS {
            change = self.rows.solve(&moved, 0).change;
        }
        let [x, y, z, ..] = change.map(f64::from);
        self.normal.dot(&Vector3::new(x, y, z))
    }
}

impl SceneSolver {
    /// Whether a way is tried where there is time: nothing is inside tissue that is not linear, nor rubs on it.
    pub(super) fn would_seek_secant(&self) -> bool {
        let inside = self.has_needles || self.has_threads || self.follower.remembers();
        self.looks_ahead && !self.follower.is_linear() && !inside
    }

    /// By how many times tissue is stiffer along the normal, on the way that the hand goes while the frame is in use, than
    /// `rows` say. None where nothing is tried, or that says nothing.
    pub(super) fn secant(
        &mut self,
        goal: &Goal,
        felt: &ToolContact,
        rows: &ToolRows,
    ) -> Option<f64> {
        if self.effort != Effort::Full || !self.would_seek_secant() {
            return None;
        }
        let normal = Vector3::from(felt.normal);
        let (_, tool) = self.parts()?.0.tool(rows.tool)?;
        let most_m = MOST_RADII * tool.radius_m();
        let way_m = MIDDLE * normal.dot(&Vector3::from(goal.ahead_m));
        let mut way_m = way_m.clamp(-most_m, most_m);
        let here_n = along(&normal, felt);
        let mut console = Console::with(rows, normal)?;
        let mut told_n = console.change_n(way_m);
        for _ in 0..MOST_HALVINGS {
            if told_n + here_n >= LEFT * here_n {
                break;
            }
            way_m *= 0.5;
            told_n = console.change_n(way_m);
        }
        if told_n.abs() < LEAST_N {
            return None;
        }
        let there = Vector3::from(goal.position_m.map(f64::from)) + normal * way_m;
        let found_n = along(&normal, &self.felt_at(there.into())?) - here_n;
        let times = found_n / told_n;
        times.is_finite().then(|| times.clamp(1.0 / MOST, MOST))
    }

    /// What the driven tool would feel somewhere else, if there is time for that.
    fn felt_at(&mut self, position_m: [f64; 3]) -> Option<ToolContact> {
        let budget = &mut self.past.budget;
        let is_paid = budget.affords(Ahead::Trial, &self.past.last) >= 1;
        if !is_paid || !budget.allows(Ahead::Trial, 0) {
            return None;
        }
        let mut samples = self.past.script.samples().to_vec();
        samples.first_mut()?.position_m = position_m;
        let options = StepOptions {
            most_rows: 0,
            ahead_m: [0.0; 3],
            reach_m: 0.0,
            ..self.options
        };
        let report = self.follower.constrained()?.try_here(&samples, &options)?;
        self.past.budget.made(Ahead::Trial, 0, &report);
        let found = report.contacts().first().copied();
        found.filter(|_| report.status == Status::Ok)
    }
}

/// Force along a normal \[N\].
fn along(normal: &Vector3<f64>, felt: &ToolContact) -> f64 {
    let [x, y, z, ..] = felt.wrench;
    normal.dot(&Vector3::new(x, y, z))
}

/// Has contact and rows say the same force here, and so many times its change elsewhere.
pub(super) fn stiffen(felt: &mut ToolContact, rows: &mut ToolRows, times: f64) {
    rows.stiffen(times);
    for entry in felt.tangent.iter_mut().flatten() {
        *entry *= times;
    }
}
