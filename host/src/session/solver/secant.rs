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
/// Longest way inside tissue, in radii of the tool: a step follows farther, but not at once.
const MOST_RADII: f64 = 0.5;
/// A hand that rests out of contact, or comes slowly, may set out, and get so deep, in the same.
const SETS_OUT: f64 = 0.3;
/// Nothing is tried for one that goes away by so much, in the same.
const GOES: f64 = 0.05;
/// Shorter ways are those of a hand that rests, in the same.
const RESTS: f64 = 1e-3;
/// One that lets go gets faster: its way over the one at its speed.
const FASTER: f64 = 2.0;
/// It is tried where this part of its force is left; less says where tissue is left, and not how.
const LEFT: f64 = 0.25;
const LEAST_LEFT: f64 = 0.05;
/// Tries to find a way on which rows give a change of force, and how far off that may be.
const TRIES: u32 = 5;
const NEAR: f64 = 0.01;
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

    /// The way out, `most_m` at most, on which the force falls by `fall_n` \[m\]; it is sought from `way_m`.
    fn way_out_m(&mut self, fall_n: f64, way_m: f64, most_m: f64) -> f64 {
        let mut way_m = way_m.min(most_m);
        for _ in 0..TRIES {
            let told_n = -self.change_n(way_m);
            let times = fall_n / told_n.max(NEAR * fall_n);
            if (times - 1.0).abs() < NEAR || (times > 1.0 && way_m >= most_m) {
                break;
            }
            way_m = (way_m * times).min(most_m);
        }
        way_m
    }
}

impl SceneSolver {
    /// Whether a way is tried where there is time: nothing is inside tissue that is not linear, nor rubs on it.
    pub(super) fn would_seek_secant(&self) -> bool {
        let inside = self.has_needles || self.has_threads || self.follower.remembers();
        self.looks_ahead && !self.follower.is_linear() && !inside
    }

    /// By how many times tissue is stiffer along the normal, on the way that the hand may go while the frame is in use, than
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
        let radius_m = tool.radius_m();
        let ahead_m = Vector3::from(goal.ahead_m);
        let way_m = MIDDLE * normal.dot(&ahead_m);
        let most_m = MOST_RADII * radius_m;
        let mut console = Console::with(rows, normal)?;
        let rests = ahead_m.norm() < RESTS * radius_m;
        let times = if felt.gap_m > 0.0 {
            let least_m = felt.gap_m + SETS_OUT * radius_m;
            let goes = way_m > GOES * radius_m;
            let way_m = way_m.clamp(-felt.gap_m - most_m, -least_m);
            (!goes).then(|| self.times_onward(goal, felt, &mut console, way_m))?
        } else if rests {
            self.times_letting_go(goal, felt, &mut console, most_m)
        } else if way_m > 0.0 {
            self.times_letting_go(goal, felt, &mut console, most_m.min(FASTER * way_m))
        } else {
            self.times_onward(goal, felt, &mut console, way_m.max(-most_m))
        };
        times
            .filter(|times| times.is_finite())
            .map(|times| times.clamp(1.0 / MOST, MOST))
    }

    /// For a way in: the change of force that is found over the one that rows say.
    fn times_onward(
        &mut self,
        goal: &Goal,
        felt: &ToolContact,
        console: &mut Console,
        way_m: f64,
    ) -> Option<f64> {
        let told_n = console.change_n(way_m);
        if told_n.abs() < LEAST_N {
            return None;
        }
        let found_n = self.found_n(goal, &console.normal, way_m)?;
        Some((found_n - along(&console.normal, felt)) / told_n)
    }

    /// For a way out: the way on which rows lose as much force as is found to go over the one on which it does. Rows of which
    /// fewer and fewer touch are not stiffer by a factor on their forces.
    fn times_letting_go(
        &mut self,
        goal: &Goal,
        felt: &ToolContact,
        console: &mut Console,
        most_m: f64,
    ) -> Option<f64> {
        let normal = console.normal;
        let here_n = along(&normal, felt);
        let stiffness = -slope(&normal, felt);
        let wanted_n = (1.0 - LEFT) * here_n;
        if stiffness <= 0.0 || wanted_n < LEAST_N || most_m * stiffness < LEAST_N {
            return None;
        }
        let way_m = console.way_out_m(wanted_n, wanted_n / stiffness, most_m);
        let left_n = self.found_n(goal, &normal, way_m)?;
        let gone_n = here_n - left_n.max(LEAST_LEFT * here_n);
        Some(console.way_out_m(gone_n, way_m, MOST * way_m) / way_m)
    }

    /// Force along the normal that the driven tool would feel after a way along it \[N\], if there is time to find out.
    fn found_n(&mut self, goal: &Goal, normal: &Vector3<f64>, way_m: f64) -> Option<f64> {
        let there = Vector3::from(goal.position_m.map(f64::from)) + normal * way_m;
        let felt = self.felt_at(there.into())?;
        Some(along(normal, &felt))
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

/// d force / d position along a normal \[N/m\].
fn slope(normal: &Vector3<f64>, felt: &ToolContact) -> f64 {
    let change = felt
        .tangent
        .map(|[x, y, z, ..]| normal.dot(&Vector3::new(x, y, z)));
    let [x, y, z, ..] = change;
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
        let text = include_str!("../../../../scenes/palpation-frictionless.toml");
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

    /// What a hand is sent that rests `high_m` above the skin.
    fn rest(law: &str, effort: Effort, high_m: f64) -> Solved {
        let (mut solver, at_rest, radius_m) = solver(law);
        solver.spare(effort);
        let mut solved = Solved::default();
        for number in 0..8_u64 {
            let state = State {
                position_m: [0.0, 0.0, (radius_m + high_m) as f32],
                mode: Mode::Armed,
                ..at_rest
            };
            solved = solver.solve(&valid(1, 1_000_000 + number * 16_667, state));
            assert_eq!(solved.status, Status::Ok);
        }
        solved
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

    /// A hand that rests in contact may let go, one that rests apart may touch: either is foretold to within what is felt.
    #[test]
    fn a_hand_that_rests_goes_on_as_its_frame_says() {
        for law in LAWS {
            for (from_m, to_m) in [(-5e-3, -1.8e-3), (8e-3, -4.2e-3)] {
                let from_n = if from_m < 0.0 {
                    true_n(law, -from_m)
                } else {
                    0.0
                };
                let true_n = true_n(law, -to_m);
                let off_n = |effort| {
                    let solved = rest(law, effort, from_m);
                    let rows = solved.rows.expect("rows");
                    let mut console = Console::with(&rows, Vector3::z()).expect("sound rows");
                    from_n + console.change_n(to_m - from_m) - true_n
                };
                let (with, without) = (off_n(Effort::Full), off_n(Effort::NoLooks));
                // What a finger notices.
                let felt_n = 0.1 * true_n + 0.03;
                assert!(with.abs() < felt_n, "{law} {from_m}: {with} of {true_n}");
                assert!(
                    without.abs() > 1.5 * with.abs(),
                    "{law} {from_m}: {without} {with}"
                );
            }
        }
    }

    /// Rows know the vertices that a tool comes to as it slides, whatever becomes of the factor meanwhile: without them, those
    /// that are left behind would push it on.
    #[test]
    fn a_stroke_goes_on_as_its_frame_says() {
        const DEEP_M: f64 = 5e-3;
        const SPEED_M_PER_S: f64 = 0.1;
        const ON_M: f64 = 6e-3;
        for law in LAWS {
            let (mut solver, at_rest, radius_m) = solver(law);
            let mut worst = 0.0_f64;
            for number in 0..28_u32 {
                let time_s = f64::from(number) / HOST_HZ;
                let state = State {
                    position_m: [
                        (0.02 - SPEED_M_PER_S * time_s) as f32,
                        0.0,
                        (radius_m - DEEP_M) as f32,
                    ],
                    velocity_m_per_s: [-SPEED_M_PER_S as f32, 0.0, 0.0],
                    mode: Mode::Armed,
                    ..at_rest
                };
                let now_us = 1_000_000 + (1e6 * time_s).round() as u64;
                let solved = solver.solve(&valid(1, now_us, state));
                // Until it is there, and has settled.
                if number < 8 {
                    continue;
                }
                assert_eq!(solved.status, Status::Ok);
                let felt = solved.contact.expect("a contact");
                let rows = solved.rows.expect("rows");
                let mut console = Console::with(&rows, -Vector3::x()).expect("sound rows");
                // Without friction nothing but the mesh pushes along a slab's top.
                let along_n = console.change_n(ON_M) - felt.wrench[0];
                worst = worst.max(along_n.abs() / felt.wrench[2]);
            }
            assert!(worst < 0.25, "{law}: {worst}");
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
