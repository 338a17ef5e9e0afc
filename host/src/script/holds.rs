//! Who takes which needle and which end of a thread, and cuts it, and when: a hand takes hold of what is within its reach, where that is then.
//!
//! Entry points: [`changes`] of a scene, [`Waiting`] for one that is due.

use crate::event::{Event, Held};
use crate::model::Model;
use crate::scene::{CutBy, Scene};
use crate::step::State;
use crate::thread::{ThreadEnd, ThreadHold};
use crate::tool::ToolSample;
use nalgebra::Vector3;

/// A needle or an end of a thread changes hands, or a thread is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Change {
    pub time_s: f64,
    pub what: Taken,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Taken {
    Needle {
        id: u8,
        tool: Option<u8>,
    },
    Thread {
        id: u8,
        end: ThreadEnd,
        by: ThreadHold,
    },
    Cut {
        id: u8,
        by: CutBy,
        knots: bool,
    },
}

/// A change that is due, until it is made or the next one of the same needle or end is due.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    what: Taken,
    /// Whether it has been told that it is out of reach.
    is_told: bool,
}

/// All of a scene, in the order of time; needles before threads.
pub(super) fn changes(scene: &Scene) -> Vec<Change> {
    let needles = scene.needles.iter().flat_map(|needle| {
        needle.holds.iter().map(|hold| {
            let (id, tool) = (needle.id, hold.tool);
            (hold.time_s, Taken::Needle { id, tool })
        })
    });
    let threads = scene.threads.iter().flat_map(|thread| {
        thread.holds.iter().map(|hold| {
            let (id, end, by) = (thread.part.id, hold.end, hold.by);
            (hold.time_s, Taken::Thread { id, end, by })
        })
    });
    let cuts = scene.threads.iter().flat_map(|thread| {
        thread.cuts.iter().map(|cut| {
            let (id, by, knots) = (thread.part.id, cut.by, cut.knots);
            (cut.time_s, Taken::Cut { id, by, knots })
        })
    });
    let all = needles.chain(threads).chain(cuts);
    let mut changes: Vec<Change> = all.map(|(time_s, what)| Change { time_s, what }).collect();
    changes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    changes
}

impl Taken {
    /// Whether it is over when the next one is made.
    fn is_left(&self, next: &Self) -> bool {
        match (*self, *next) {
            (Self::Needle { id, .. }, Self::Needle { id: other, .. }) => id == other,
            (
                Self::Thread { id, end, by },
                Self::Thread {
                    id: other,
                    end: next,
                    by: hand,
                },
            ) => id == other && end.is_left(by, (next, hand)),
            _ => false,
        }
    }

    fn held(&self) -> Held {
        match *self {
            Self::Needle { id, .. } => Held::Needle(id),
            Self::Thread { id, end, .. } => Held::Thread(id, end),
            Self::Cut { id, .. } => Held::Thread(id, ThreadEnd::Span),
        }
    }
}

impl Waiting {
    pub fn new(change: Change) -> Self {
        Self {
            what: change.what,
            is_told: false,
        }
    }

    /// Whether its time is over when `next` is due.
    pub fn ends_with(&self, next: &Change) -> bool {
        self.what.is_left(&next.what)
    }

    /// The tool that is to take hold.
    pub fn tool(&self) -> Option<u8> {
        match self.what {
            Taken::Needle { tool, .. } => tool,
            Taken::Thread {
                by: ThreadHold::Tool(tool),
                ..
            }
            | Taken::Cut {
                by: CutBy::Tool(tool),
                ..
            } => Some(tool),
            Taken::Thread { .. } | Taken::Cut { .. } => None,
        }
    }

    /// What is to be told where a tool at `sample` is farther than it reaches \[m\] from what it is to take.
    pub fn missed(
        &self,
        sample: &ToolSample,
        reach_m: f64,
        model: &Model,
        state: &State,
    ) -> Option<Event> {
        let at = &sample.position_m;
        let nearest_m = match self.what {
            Taken::Needle { id, .. } => state.nearest_of_needle(model, id, at),
            Taken::Thread { id, end, .. } => state.nearest_of_thread(model, id, end, at),
            Taken::Cut { id, .. } => state.nearest_of_thread(model, id, ThreadEnd::Span, at),
        }?;
        let distance_m = Vector3::from(nearest_m).metric_distance(&Vector3::from(*at));
        let within = distance_m <= reach_m;
        (!within).then_some(Event::Missed {
            tool: sample.id,
            what: self.what.held(),
            distance_m,
            nearest_m,
        })
    }

    /// `missed`, the first time.
    pub fn tell(&mut self, missed: Event) -> Option<Event> {
        (!std::mem::replace(&mut self.is_told, true)).then_some(missed)
    }

    /// Has it held. The scene has been checked: there are such a needle and such a thread.
    pub fn make(&self, samples: &[ToolSample], model: &Model, state: &mut State) {
        match self.what {
            Taken::Needle { id, tool } => {
                let by = tool.and_then(|id| samples.iter().find(|sample| sample.id == id));
                state.hold(model, id, by);
            }
            Taken::Thread { id, end, by } => {
                state.hold_thread(model, id, end, by, samples);
            }
            Taken::Cut { id, by, knots } => {
                let tool = |id: u8| samples.iter().find(|sample| sample.id == id);
                let at = match by {
                    CutBy::Tool(id) => tool(id).map(|sample| sample.position_m),
                    CutBy::Place(at) => Some(at),
                };
                if let Some(at) = at {
                    state.cut_thread(model, id, &at, knots);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::SCENE;
    use super::super::{Script, path};
    use super::*;
    use crate::scene::{Document, Scene};
    use crate::step::{Status, StepOptions, step};

    const SECOND: &str = "[[tool.way_point]]
time_s = 1.0
position_m = [0.0, 0.0, 0.1]
[[tool.way_point]]
time_s = 3.0
position_m = [0.0, 0.05, 0.1]
";

    /// The scene of scripts, whose second hand reaches as far as any and goes by `way`. From 2.0 s on the needle lies from (0, 0, 50)
    /// to (-20, 0, 50) mm.
    fn scene(way: &str) -> Scene {
        let text = SCENE.replace("reach_m = 0.1\n", "").replace(SECOND, way);
        let text = text.replace(
            "[[needle.hold]]\ntime_s = 2.0",
            "[[needle.hold]]\ntime_s = 2.25",
        );
        assert_eq!(text.matches("reach_m").count(), 1);
        assert!(text.contains(way) && text.contains("2.25"));
        let document = Document::embedded("test.toml", "".as_ref(), &text);
        Scene::read(&document, "test").expect("good")
    }

    /// Who holds the needle every 0.1 s, and what hands have missed when.
    fn follow(scene: &Scene) -> (Vec<Option<u8>>, Vec<(f64, Event)>) {
        let (model, mut state, mut work) = scene.build().expect("a model");
        let mut script = Script::new(scene);
        let (mut held_by, mut told) = (Vec::new(), Vec::new());
        for place in 0..=40 {
            let time_s = 0.1 * f64::from(place);
            let tools = script.follow(time_s, &model, &mut state);
            let report = step(
                &model,
                &mut state,
                tools,
                &StepOptions::default(),
                &mut work,
            );
            assert_eq!(report.status, Status::Ok, "at {time_s} s");
            held_by.push(report.needles()[0].held_by);
            told.extend(script.take_missed().map(|missed| (time_s, missed)));
        }
        (held_by, told)
    }

    /// 9 cm above the needle the second hand holds nothing: the first one goes on until it lets go. That is told once.
    #[test]
    fn a_grip_9_cm_away_holds_nothing() {
        let scene = scene(
            "[[tool.way_point]]
time_s = 0.0
position_m = [-0.01, 0.0, 0.14]
",
        );
        assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
        let warning = scene.warnings[0].to_string();
        for said in ["tool 6", "needle 1", "90.0 mm", "5.0 mm"] {
            assert!(warning.contains(said), "{warning}");
        }
        let (held_by, told) = follow(&scene);
        assert!(
            held_by[..35].iter().all(|tool| *tool == Some(4)),
            "{held_by:?}"
        );
        assert!(held_by[35..].iter().all(Option::is_none), "{held_by:?}");
        let [
            (
                time_s,
                Event::Missed {
                    tool,
                    what,
                    distance_m,
                    nearest_m,
                },
            ),
        ] = told[..]
        else {
            panic!("{told:?}");
        };
        assert!((time_s - 2.3).abs() < 1e-9, "{time_s}");
        assert_eq!((tool, what), (6, Held::Needle(1)));
        // The hand's path is in single precision.
        assert!((distance_m - 0.09).abs() < 1e-8, "{distance_m}");
        let below = Vector3::new(-0.01, 0.0, 0.05);
        assert!((Vector3::from(nearest_m) - below).norm() < 1e-8);
    }

    /// It comes down from 9 cm, and takes the needle once it is within 5 mm, in the script's plan as well.
    #[test]
    fn a_hold_is_tried_until_the_hand_is_there() {
        let scene = scene(
            "[[tool.way_point]]
time_s = 2.0
position_m = [-0.01, 0.0, 0.14]
[[tool.way_point]]
time_s = 3.0
position_m = [-0.01, 0.0, 0.05]
[[tool.way_point]]
time_s = 4.0
position_m = [-0.01, 0.02, 0.05]
",
        );
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        let (held_by, told) = follow(&scene);
        assert_eq!(told.len(), 1, "{told:?}");
        let way = scene.tools[1].way.as_ref().expect("it moves");
        let height = |place: u32| way.at(0.1 * f64::from(place)).moved.expect("it moves").0[2];
        for (place, tool) in (0..).zip(&held_by).skip(23) {
            // It is taken by where the hand was in the step before.
            let is_there = height(place - 1) <= 0.055;
            let expected = if place >= 35 {
                None
            } else if is_there {
                Some(6)
            } else {
                Some(4)
            };
            assert_eq!(*tool, expected, "{place} {held_by:?}");
        }
        assert!(
            held_by[28] == Some(4) && held_by[31] == Some(6),
            "{held_by:?}"
        );
        // It goes with that hand until it is let go.
        let path = path(&scene, 4.0, 0.1, 1.0);
        let end = path.needles[2 * 34];
        assert!(end.y > 1e-3, "{end}");
    }

    /// What nobody holds any more is not taken by whoever comes late.
    #[test]
    fn a_hold_whose_time_is_over_is_not_tried() {
        let scene = scene(
            "[[tool.way_point]]
time_s = 3.6
position_m = [-0.01, 0.0, 0.14]
[[tool.way_point]]
time_s = 3.9
position_m = [-0.01, 0.0, 0.05]
",
        );
        assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
        let (held_by, told) = follow(&scene);
        assert_eq!((held_by[40], told.len()), (None, 1), "{held_by:?}");
    }
}
