//! A hand that follows a page: what a simulated console's hand is told, in short straight ways.
//!
//! Entry points: [`Guide::order`] every so often, [`Guide::drag`], [`Guide::go`]. How it was dragged last it can do again.

use super::settings::Grasp;
use sutura_host::scene::{joints_at, position_at};
use sutura_shared::device::{JOINTS, Kinematics};
use sutura_shared::wire::message::{HandScript, WAY_POINTS, WayPoint};
use sutura_view::Hand;

/// Time between two ways of a hand that is dragged \[s\].
pub const PERIOD_S: f64 = 0.01;
/// Times that are this near are the same \[s\].
const ROUNDING_S: f64 = 1e-6;
/// Time in which it follows the page: what comes 30 times a second is not felt as steps \[s\].
const SMOOTH_S: f64 = 0.03;
/// Fastest that it follows \[m/s\].
const FASTEST_M_PER_S: f64 = 0.3;
/// How long it stays where it was let go \[s\].
const HOLD_S: f64 = 0.3;
/// How fast it goes back then \[m/s\].
const BACK_M_PER_S: f64 = 0.06;
/// Distance between two places that it remembers \[m\], and how many of these.
const APART_M: f64 = 5e-4;
const PLACES: usize = 2000;
/// How fast it goes to where the scene's hand begins \[m/s\], and for how long at least \[s\].
const TO_START_M_PER_S: f64 = 0.1;
const TO_START_S: f64 = 0.3;
/// Speed at which a tool is taken out of the tissue \[m/s\], and the least duration \[s\].
const OUT_M_PER_S: f64 = 0.1;
const OUT_S: f64 = 0.3;
/// Stiffness and damping with which a tool is taken out at least: a soft hand lets a grip whose motors are off sink by its weight.
const OUT_N_PER_M: f32 = 2000.0;
const OUT_N_S_PER_M: f32 = 40.0;
/// Time for which it holds the grip so once the console is armed again: its motors take the weight by then \[s\].
const ARMS_S: f64 = 0.5;
/// Longest way that it can do again, in periods: 10 min.
const LONGEST_WAY: usize = 60_000;
/// Refusal of a hand's motion while the motors are off, and the next step.
pub const NOT_HELD: (&str, &str) = ("nobody holds a grip whose motors are off", "arm first");
/// What is said where nobody has dragged it.
pub const NO_WAY: &str = "the tool was not dragged yet";
/// See there.
pub const NO_WAY_HELP: &str = "drag it, and it does that again";

/// What the hand is about.
#[derive(Clone, Debug)]
enum Doing {
    /// What its script says.
    Script,
    /// It follows a place \[m\].
    Drag([f64; 3]),
    /// It was let go at this time \[s\].
    Held(f64),
    /// It goes back by which it came.
    Back,
    /// It goes to where a way begins, and follows that from this time on \[s\].
    ToStart(Way, f64),
    /// It does again what it did when it was dragged last, from this place of that on.
    Again(usize),
    /// It has taken a tool out, and holds it firmly until this time \[s\], which counts from when the console is armed.
    Out(Option<f64>),
}

/// A way that it can go.
#[derive(Clone, Copy, Debug)]
enum Way {
    Scene,
    Dragged,
}

/// The hand on a simulated console. Times are those by which the console's own script runs \[s\].
#[derive(Clone, Debug)]
pub struct Guide {
    kinematics: Kinematics,
    scenes: HandScript,
    script: HandScript,
    since_s: f64,
    doing: Doing,
    /// Where it has been since it was taken \[m\].
    places: Vec<[f64; 3]>,
    /// Where it wanted the grip in every period from when it was taken last to when it was let go \[m\].
    dragged: Vec<[f64; 3]>,
    next_s: f64,
    /// The console was told to rest, and was not seen at rest since.
    rests: bool,
}

impl Guide {
    /// A hand that has just begun the scene's script on a console of these kinematics.
    pub fn new(scenes: HandScript, kinematics: Kinematics) -> Self {
        Self {
            kinematics,
            script: scenes,
            scenes,
            since_s: 0.0,
            doing: Doing::Script,
            places: Vec::new(),
            dragged: Vec::new(),
            next_s: 0.0,
            rests: false,
        }
    }

    /// Whether it may move the grip of a console that renders or does not: not once the console was told to rest, whatever its last
    /// state says.
    pub fn moves(&mut self, renders: bool) -> bool {
        self.rests &= renders;
        renders && !self.rests
    }

    /// Takes note that the console is told to arm.
    pub fn arm(&mut self) {
        self.rests = false;
    }

    /// Where it wants the grip now \[m\].
    pub fn at(&self, now_s: f64) -> [f64; 3] {
        position_at(&self.script, now_s - self.since_s)
    }

    /// It follows a place from now on, or lets go.
    pub fn drag(&mut self, now_s: f64, to_m: Option<[f64; 3]>) {
        match (to_m, &self.doing) {
            (Some(to_m), Doing::Drag(_)) => self.doing = Doing::Drag(to_m),
            (Some(to_m), _) => {
                self.dragged = vec![self.at(now_s)];
                if !matches!(self.doing, Doing::Held(_) | Doing::Back) {
                    self.places.clear();
                }
                self.doing = Doing::Drag(to_m);
                self.next_s = now_s;
            }
            (None, Doing::Drag(_)) => self.doing = Doing::Held(now_s),
            (None, _) => {}
        }
    }

    /// Ends a drag, and what follows one, with a console that is told to rest: it does what it was told last, and stays where that ends.
    pub fn stop(&mut self) {
        self.places.clear();
        self.doing = Doing::Script;
        self.rests = true;
    }

    /// Whether it was dragged.
    pub fn has_way(&self) -> bool {
        self.dragged.len() > 1
    }

    /// It goes to where a way begins and follows that, or it stays where it is.
    pub fn go(&mut self, now_s: f64, hand: Hand) -> HandScript {
        let at = self.at(now_s);
        self.places.clear();
        let (way, start) = match (hand, self.dragged.first()) {
            (Hand::Scene, _) => (Way::Scene, position_at(&self.scenes, 0.0)),
            (Hand::Recorded, Some(start)) => (Way::Dragged, *start),
            (Hand::Recorded, None) | (Hand::Still, _) => {
                self.doing = Doing::Script;
                return self.tell(now_s, &[(0.0, at)]);
            }
        };
        let way_s = (distance(&at, &start) / TO_START_M_PER_S).max(TO_START_S);
        self.doing = Doing::ToStart(way, now_s + way_s);
        self.tell(now_s, &[(0.0, at), (way_s, start)])
    }

    /// Goes straight from one place to another, in a firm grasp, and stays there until the console is armed; the console's joints are at
    /// `start_joint`. What it is told, and how long that takes \[s\].
    pub fn take_out(
        &mut self,
        now_s: f64,
        [from, to]: [[f64; 3]; 2],
        start_joint: [f32; JOINTS],
    ) -> (HandScript, f64) {
        self.stop();
        self.doing = Doing::Out(None);
        let way_s = (distance(&from, &to) / OUT_M_PER_S).max(OUT_S);
        let script = self.tell(now_s, &[(0.0, from), (way_s, to)]);
        self.script = HandScript {
            start_joint,
            stiffness_n_per_m: script.stiffness_n_per_m.max(OUT_N_PER_M),
            damping_n_s_per_m: script.damping_n_s_per_m.max(OUT_N_S_PER_M),
            ..script
        };
        (self.script, way_s)
    }

    /// Takes hold of the grip so with its next order.
    pub fn take(&mut self, grasp: Grasp) {
        self.scenes.stiffness_n_per_m = grasp.stiffness_n_per_m;
        self.scenes.damping_n_s_per_m = grasp.damping_n_s_per_m;
    }

    /// Takes hold of a grip at rest where that is: a spring that became stiffer would throw one that has sunk. What it is told.
    pub fn hold_at_rest(&mut self, now_s: f64, grasp: Grasp, at: [f64; 3]) -> HandScript {
        self.take(grasp);
        self.stay(now_s, at)
    }

    /// Stays at a place, whatever it was about. What it is told.
    pub fn stay(&mut self, now_s: f64, at: [f64; 3]) -> HandScript {
        self.places.clear();
        self.doing = Doing::Script;
        self.tell(now_s, &[(0.0, at)])
    }

    /// From now on it holds the grip so; what it is told for that, which is what is left of what it was told last.
    pub fn hold(&mut self, now_s: f64, grasp: Grasp) -> HandScript {
        self.take(grasp);
        let passed_s = now_s - self.since_s;
        let used = self.script.way_points.get(..usize::from(self.script.count));
        let to_come = used.unwrap_or_default().iter().filter_map(|point| {
            let left_s = f64::from(point.time_s) - passed_s;
            (left_s > ROUNDING_S).then(|| (left_s, point.position_m.map(f64::from)))
        });
        let mut left: Vec<_> = to_come.collect();
        // Before its first point it rests there already.
        if left.len() < usize::from(self.script.count) {
            left.insert(0, (0.0, self.at(now_s)));
        }
        self.tell(now_s, &left)
    }

    /// What the console's hand is told now, if anything.
    pub fn order(&mut self, now_s: f64) -> Option<HandScript> {
        match self.doing.clone() {
            Doing::Script => None,
            Doing::Out(None) => {
                self.doing = Doing::Out(Some(now_s + ARMS_S));
                None
            }
            Doing::Out(Some(until_s)) if now_s < until_s => None,
            Doing::Out(Some(_)) => {
                self.doing = Doing::Script;
                Some(self.tell(now_s, &[(0.0, self.at(now_s))]))
            }
            Doing::ToStart(_, then_s) if now_s < then_s => None,
            Doing::ToStart(Way::Scene, _) => {
                self.doing = Doing::Script;
                (self.script, self.since_s) = (self.scenes, now_s);
                Some(self.script)
            }
            Doing::ToStart(Way::Dragged, _) => {
                self.doing = Doing::Again(1);
                self.next_s = now_s;
                self.order(now_s)
            }
            Doing::Held(since_s) if now_s < since_s + HOLD_S => None,
            Doing::Held(_) => {
                self.doing = Doing::Back;
                self.next_s = now_s;
                self.order(now_s)
            }
            _ if now_s < self.next_s - ROUNDING_S => None,
            Doing::Drag(to_m) => {
                let from = self.at(now_s);
                if self
                    .places
                    .last()
                    .is_none_or(|last| distance(last, &from) >= APART_M)
                    && self.places.len() < PLACES
                {
                    self.places.push(from);
                }
                let part = 1.0 - (-PERIOD_S / SMOOTH_S).exp();
                let way = part * distance(&from, &to_m);
                let part =
                    part * (FASTEST_M_PER_S * PERIOD_S / way.max(f64::MIN_POSITIVE)).min(1.0);
                let to = towards(&from, &to_m, part);
                if self.dragged.len() < LONGEST_WAY {
                    self.dragged.push(to);
                }
                Some(self.step(now_s, from, &to))
            }
            Doing::Again(place) => {
                let Some(to) = self.dragged.get(place).copied() else {
                    self.doing = Doing::Script;
                    return None;
                };
                self.doing = Doing::Again(place + 1);
                Some(self.step(now_s, self.at(now_s), &to))
            }
            Doing::Back => {
                let from = self.at(now_s);
                let most_m = BACK_M_PER_S * PERIOD_S;
                while self.places.len() > 1
                    && self
                        .places
                        .last()
                        .is_some_and(|last| distance(last, &from) < most_m)
                {
                    self.places.pop();
                }
                let Some(to) = self.places.last().copied() else {
                    self.doing = Doing::Script;
                    return None;
                };
                let left_m = distance(&from, &to);
                if left_m < 1e-6 {
                    self.places.clear();
                    self.doing = Doing::Script;
                    return None;
                }
                let part = (most_m / left_m).min(1.0);
                Some(self.step(now_s, from, &towards(&from, &to, part)))
            }
        }
    }

    /// A way of one period, from where the last one has got to.
    fn step(&mut self, now_s: f64, from: [f64; 3], to: &[f64; 3]) -> HandScript {
        self.next_s = now_s + PERIOD_S;
        self.tell(now_s, &[(0.0, from), (PERIOD_S, *to)])
    }

    fn tell(&mut self, now_s: f64, points: &[(f64, [f64; 3])]) -> HandScript {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        for (place, (time_s, at)) in way_points.iter_mut().zip(points) {
            *place = WayPoint {
                time_s: *time_s as f32,
                position_m: at.map(|x| x as f32),
            };
        }
        // A console that has come to rest meanwhile begins there.
        let here = points
            .first()
            .and_then(|(_, at)| joints_at(&self.kinematics, *at));
        self.script = HandScript {
            count: points.len() as u8,
            way_points,
            start_joint: here.unwrap_or(self.scenes.start_joint),
            ..self.scenes
        };
        self.since_s = now_s;
        self.script
    }
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

fn towards(from: &[f64; 3], to: &[f64; 3], part: f64) -> [f64; 3] {
    [0, 1, 2].map(|axis: usize| from[axis] + (to[axis] - from[axis]) * part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::wire::Message;
    use sutura_shared::wire::message::Simulate;

    const BENCH: Kinematics = Kinematics::Cartesian { origin_m: [0.0; 3] };

    fn hand() -> HandScript {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        way_points[0].position_m = [0.0, 0.0, 0.05];
        HandScript {
            stiffness_n_per_m: 500.0,
            damping_n_s_per_m: 5.0,
            start_joint: [0.0; 3],
            count: 1,
            way_points,
        }
    }

    /// Every tick of so many seconds; where it wants the grip.
    fn run(guide: &mut Guide, from_s: f64, seconds: f64) -> Vec<[f64; 3]> {
        let ticks = (1000.0 * seconds) as u32;
        let each = (0..ticks).map(|tick| {
            let now_s = from_s + 1e-3 * f64::from(tick);
            guide.order(now_s);
            guide.at(now_s)
        });
        each.collect()
    }

    /// After a safe stop the hand stays where its last order ends, whatever it was dragged to.
    #[test]
    fn a_stop_ends_a_drag() {
        let mut guide = Guide::new(hand(), BENCH);
        guide.drag(0.5, Some([0.02, 0.0, 0.03]));
        run(&mut guide, 0.5, 0.05);
        assert!(guide.moves(true));
        guide.stop();
        assert!(!guide.moves(true), "the console has not obeyed yet");
        let after = run(&mut guide, 0.55, 1.0);
        let end = after[after.len() - 1];
        assert!(distance(&after[0], &end) < FASTEST_M_PER_S * PERIOD_S);
        assert!(distance(&end, &[0.02, 0.0, 0.03]) > 5e-3, "{end:?}");
        assert!(!guide.moves(false) && guide.moves(true), "armed since");
        guide.stop();
        guide.arm();
        assert!(guide.moves(true));
    }

    /// It follows without a jump and not too fast, waits when it is let go, and goes back by which it came.
    #[test]
    fn it_follows_holds_and_goes_back() {
        let mut guide = Guide::new(hand(), BENCH);
        assert!(
            run(&mut guide, 0.0, 0.5)
                .iter()
                .all(|at| at[2] == f64::from(0.05_f32))
        );
        guide.drag(0.5, Some([0.02, 0.0, 0.03]));
        let there = run(&mut guide, 0.5, 0.6);
        let end = there[there.len() - 1];
        assert!(distance(&end, &[0.02, 0.0, 0.03]) < 1e-4, "{end:?}");
        for two in there.windows(2) {
            // A way with minimum jerk is at most 15/8 times as fast as on average.
            assert!(distance(&two[0], &two[1]) < 1.9 * 1e-3 * FASTEST_M_PER_S);
        }
        guide.drag(1.1, None);
        let held = run(&mut guide, 1.1, 0.29);
        assert!(distance(&held[200], &held[280]) < 1e-6);
        let back = run(&mut guide, 1.39, 1.0);
        let home = back[back.len() - 1];
        assert!(distance(&home, &[0.0, 0.0, 0.05]) < 1e-4, "{home:?}");
        for at in &back {
            let nearest = there
                .iter()
                .map(|other| distance(at, other))
                .fold(1.0, f64::min);
            assert!(nearest < 1e-3, "it came by {nearest} m from here");
        }
        assert!(guide.order(3.0).is_none(), "it rests");
    }

    /// The scene's hand begins where it begins, after a way there.
    #[test]
    fn it_goes_to_where_the_scene_begins() {
        let mut guide = Guide::new(hand(), BENCH);
        guide.drag(0.0, Some([0.05, 0.0, 0.05]));
        run(&mut guide, 0.0, 1.0);
        let script = guide.go(1.0, Hand::Scene);
        assert_eq!(script.count, 2);
        let way = run(&mut guide, 1.0, 1.0);
        assert!(way.windows(2).all(|two| distance(&two[0], &two[1]) < 3e-4));
        assert!(distance(&way[way.len() - 1], &[0.0, 0.0, 0.05]) < 1e-6);
        let script = guide.go(2.0, Hand::Still);
        assert_eq!(script.count, 1);
        // Of a console at rest it would be the place.
        assert_eq!(script.start_joint, script.way_points[0].position_m);
    }
    /// Held otherwise in the middle of a way, it is where it was, comes by all points that are left at their times, and is held so
    /// in what comes after.
    #[test]
    fn it_is_held_otherwise_and_goes_on() {
        let mut script = hand();
        let places = [[0.0, 0.0, 0.05], [0.0, 0.02, 0.05], [0.01, 0.0, 0.04]];
        for (point, (time_s, at)) in script
            .way_points
            .iter_mut()
            .zip([0.1, 0.5, 1.1].into_iter().zip(places))
        {
            (point.time_s, point.position_m) = (time_s, at);
        }
        script.count = 3;
        let grasp = Grasp {
            stiffness_n_per_m: 900.0,
            damping_n_s_per_m: 9.0,
        };
        for changed_s in [0.0, 0.05, 0.1, 0.3, 0.5, 0.8, 1.1, 2.0] {
            let mut guide = Guide::new(script, BENCH);
            let before = guide.at(changed_s);
            let told = guide.hold(changed_s, grasp);
            assert_eq!(Simulate::Hand(told).check(), Ok(()), "at {changed_s} s");
            assert_eq!(told.stiffness_n_per_m, 900.0);
            assert!(distance(&guide.at(changed_s), &before) < 1e-7);
            for (time_s, at) in [0.1, 0.5, 1.1].into_iter().zip(places) {
                if time_s >= changed_s {
                    let off_m = distance(&guide.at(time_s), &at.map(f64::from));
                    assert!(
                        off_m < 1e-5,
                        "held at {changed_s} s: {off_m} m off at {time_s} s"
                    );
                }
            }
            let still = guide.go(3.0, Hand::Still);
            assert_eq!(still.damping_n_s_per_m, 9.0);
            // A grip that has sunk at rest is held there.
            let sunk = guide.hold_at_rest(4.0, grasp, [0.0, 0.0, -0.042]);
            assert_eq!((sunk.count, guide.at(5.0)[2]), (1, f64::from(-0.042_f32)));
            assert_eq!(sunk.start_joint, sunk.way_points[0].position_m);
        }
    }

    /// Taken out of the tissue in the middle of a drag, it follows that no more, and stays where it has come to.
    #[test]
    fn it_takes_a_tool_out_and_stays_there() {
        let mut guide = Guide::new(hand(), BENCH);
        guide.drag(0.0, Some([0.0, 0.0, -0.011]));
        run(&mut guide, 0.0, 1.0);
        let ends = [[0.0, 0.0, -0.011], [0.0, 0.0, 0.02]];
        let (script, way_s) = guide.take_out(1.0, ends, [0.1, 0.2, 0.3]);
        assert_eq!(Simulate::Hand(script).check(), Ok(()));
        assert_eq!(script.start_joint, [0.1, 0.2, 0.3]);
        assert_eq!(
            script.stiffness_n_per_m, OUT_N_PER_M,
            "a soft hand lets it sink"
        );
        assert!((way_s - 0.31).abs() < 1e-6, "{way_s} s");
        // Its orders are asked for once the console is armed.
        assert!(guide.order(2.0).is_none() && guide.order(2.49).is_none());
        let way: Vec<_> = (0..1000)
            .map(|tick| guide.at(1.0 + 1e-3 * f64::from(tick)))
            .collect();
        assert!(way.windows(2).all(|two| two[1][2] >= two[0][2]));
        assert!(distance(&way[way.len() - 1], &ends[1]) < 1e-6);
        let own = guide.order(2.5).map(|script| script.stiffness_n_per_m);
        assert_eq!(own, Some(500.0), "its motors carry it");
        assert!(distance(&guide.at(3.0), &ends[1]) < 1e-6);
        assert!(guide.order(3.0).is_none(), "it rests");
    }

    /// What it did when it was dragged it does again, as fast, from where it was taken, and stays where it was let go.
    #[test]
    fn it_does_again_what_it_did() {
        let mut guide = Guide::new(hand(), BENCH);
        assert!(!guide.has_way());
        guide.drag(0.0, Some([0.02, 0.0, 0.03]));
        let mut way = run(&mut guide, 0.0, 0.4);
        guide.drag(0.4, Some([0.0, 0.01, 0.04]));
        way.extend(run(&mut guide, 0.4, 0.4));
        guide.drag(0.8, None);
        run(&mut guide, 0.8, 2.0);
        assert!(guide.has_way());
        let script = guide.go(3.0, Hand::Recorded);
        // It is there already, and takes its time.
        assert_eq!(script.count, 2);
        run(&mut guide, 3.0, 0.3);
        let again = run(&mut guide, 3.3, 0.8);
        for (i, (then, now)) in way.iter().zip(&again).enumerate() {
            assert!(distance(then, now) < 1e-4, "{i}: {now:?}, not {then:?}");
        }
        let after = run(&mut guide, 4.2, 0.5);
        let end = way[way.len() - 1];
        assert!(after.iter().all(|at| distance(at, &end) < 2e-4));
        assert!(guide.order(5.0).is_none(), "it rests");
    }
}
