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
            change = self.rows.solve(&moved).change;
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

#[cfg(test)]
#[allow(clippy::expect_used, reason = "tests")]
mod tests {
    use super::super::super::late_tests::{plan, valid};
    use super::super::super::{Solve, Solved};
    use super::*;
    use crate::scene::{Document, Scene};
    use std::path::Path;
    use sutura_shared::control::{Control, TickInput};
    use sutura_shared::wire::message::{Mode, State};

    const LAWS: [&str; 2] = ["corotational", "hyperelastic"];
    const HOST_HZ: f64 = 60.0;
    /// Of a tap \[m/s\].
    const DOWN_M_PER_S: f64 = 0.25;
    /// Above the skin where the frame is made, below where it is used \[m\].
    const HIGH_M: f64 = 1.7e-3;
    const DEEP_M: f64 = 4.4e-3;

    fn solver(law: &str) -> (SceneSolver, State, f64) {
        let text = include_str!("../../../../scenes/palpation.toml");
        let text = text.replace("divisions = [20, 20, 8]", "divisions = [10, 10, 4]");
        let text = text.replace("model = \"linear\"", &format!("model = \"{law}\""));
        let document = Document::embedded(law, Path::new(""), &text);
        let scene = Scene::read(&document, law).expect("a scene");
        let plan = plan(&scene, HOST_HZ);
        let solver = SceneSolver::for_session(&scene, &plan).expect("a solver");
        let mut control = Control::new(plan.device).expect("a device");
        let at_rest = control.tick(&TickInput::default(), None).state;
        (solver, at_rest, scene.tools[0].shape.radius_m())
    }

    /// On a way down, the last of whose solves is `high_m` above the skin.
    fn tap(law: &str, effort: Effort, high_m: f64) -> (SceneSolver, Solved) {
        let (mut solver, at_rest, radius_m) = solver(law);
        solver.spare(effort);
        let mut solved = Solved::default();
        for before in (0..4).rev() {
            let up_m = high_m + f64::from(before) * DOWN_M_PER_S / HOST_HZ;
            let now_us = 1_000_000 + u64::from(4 - before as u32) * 16_667;
            let state = State {
                position_m: [0.0, 0.0, (radius_m + up_m) as f32],
                velocity_m_per_s: [0.0, 0.0, -DOWN_M_PER_S as f32],
                mode: Mode::Armed,
                ..at_rest
            };
            solved = solver.solve(&valid(1, now_us, state));
            assert_eq!(solved.status, Status::Ok);
        }
        (solver, solved)
    }

    /// Force after all has come to rest there \[N\].
    fn true_n(law: &str, deep_m: f64) -> f64 {
        let (mut solver, mut solved) = tap(law, Effort::Full, -deep_m);
        let sample = *solver.samples().first().expect("a tool");
        for _ in 0..20 {
            let report = solver.step(sample);
            solved.contact = report.contacts().first().copied();
        }
        solved.contact.expect("a contact").wrench[2]
    }

    /// Taken for what they are where the tool is, rows are off by what tissue stiffens or softens on the way.
    #[test]
    fn a_touch_goes_on_as_its_frame_says() {
        for law in LAWS {
            let true_n = true_n(law, DEEP_M);
            let off = |effort| {
                let (_, solved) = tap(law, effort, HIGH_M);
                let rows = solved.rows.expect("rows");
                let mut console = Console::with(&rows, Vector3::z()).expect("sound rows");
                console.change_n(-HIGH_M - DEEP_M) / true_n - 1.0
            };
            let (with, without) = (off(Effort::Full), off(Effort::NoLooks));
            assert!(with.abs() < 0.03, "{law}: {with}");
            assert!(without.abs() > 0.06, "{law}: {without}");
        }
    }

    /// A step that comes from 4 mm away is as good as one that rests, where there is time for more than one pass.
    #[test]
    fn a_step_over_turning_tissue_is_in_balance_where_there_is_time() {
        let deep_m = 2.5e-3;
        let true_n = true_n("corotational", deep_m);
        let off = |effort| {
            let (_, solved) = tap("corotational", effort, -deep_m);
            solved.contact.expect("a contact").wrench[2] / true_n - 1.0
        };
        let (with, without) = (off(Effort::Full), off(Effort::NoLooks));
        assert!(with.abs() < 0.02, "{with}");
        assert!(without.abs() > 0.05, "{without}");
    }

    /// What is tried feels more, deeper, and leaves every node where it was.
    #[test]
    fn a_place_is_tried_and_left() {
        for law in LAWS {
            let (mut solver, _) = tap(law, Effort::NoLooks, -1e-3);
            let mut sample = *solver.samples().first().expect("a tool");
            for _ in 0..20 {
                solver.step(sample);
            }
            let before = solver.positions_m().into_owned();
            let here_n = solver.past.last.contacts()[0].wrench[2];
            sample.position_m[2] -= 3e-4;
            solver.past.budget.begin(&solver.past.last);
            let there = solver.felt_at(sample.position_m).expect("a contact");
            assert!(there.wrench[2] > 1.1 * here_n, "{law}: {here_n} {there:?}");
            assert_eq!(solver.positions_m().into_owned(), before, "{law}");
        }
    }
}
