//! Whether scripts bring hands to what they are to hold, and no farther from each other than a thread between them is long.
//!
//! Entry point: [`out_of_reach`]. Needles go with who holds them, as in the open; where a thread hangs nobody knows, but it has
//! not been where its needle's end has not been.

use super::document::{Document, Flaw};
use super::hand::position_at;
use super::{Needle, Thread, Tool};
use crate::thread::{ThreadEnd, ThreadHold};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use sutura_scene_file::scene::NeedleSection;
use sutura_scene_file::wound::ThreadSection;
use sutura_shared::wire::message::HandScript;
use toml::Spanned;

/// Time between two looks \[s\]: a hand at 0.1 m/s goes 1 mm meanwhile.
const EVERY_S: f64 = 0.01;
/// Most looks at one hold.
const MOST_LOOKS: f64 = 2000.0;

/// Scripts of tools, and when everything rests.
struct Scripts<'a> {
    tools: &'a [Tool],
    hand: Option<&'a HandScript>,
    end_s: f64,
}

/// From a time on \[s\] a needle is in the frame of a tool, or in the world's.
struct Stint {
    from_s: f64,
    tool: Option<u8>,
    pose: Isometry3<f64>,
}

/// How near a tool comes while it is to take hold \[m\].
struct Nearest {
    distance_m: f64,
    at_s: f64,
}

/// A hold that is not taken, its tool, and how near that comes.
type Missed<'a> = (usize, &'a Tool, Nearest);

/// A warning for each hold by a tool whose script does not bring it there. Nothing is known of the console's tool without a hand,
/// nor of what it has held.
pub(super) fn out_of_reach(
    document: &Document,
    (needle_sections, thread_sections): (&[Spanned<NeedleSection>], &[Spanned<ThreadSection>]),
    (needles, threads): (&[Needle], &[Thread]),
    tools: &[Tool],
    hand: Option<&HandScript>,
) -> Vec<Flaw> {
    let scripts = Scripts::new(tools, hand, needles, threads);
    let mut warnings = Vec::new();
    for (needle, section) in needles.iter().zip(needle_sections) {
        let what = format!("needle {}", needle.id);
        let (stints, missed) = scripts.stints(needle);
        for (place, tool, nearest) in missed {
            let span = section.get_ref().hold[place].span();
            warnings.push(warning(document, span, &what, tool, &nearest));
        }
        let Some(stints) = stints else {
            continue;
        };
        let own = threads.iter().zip(thread_sections);
        for (thread, section) in own.filter(|(thread, _)| thread.part.needle == needle.id) {
            let what = format!("thread {}", thread.part.id);
            for (place, tool, nearest) in scripts.missed_threads(thread, &stints) {
                let span = section.get_ref().hold[place].span();
                warnings.push(warning(document, span, &what, tool, &nearest));
            }
            if let Some((place, far)) = scripts.too_far(thread, needle, &stints) {
                let span = section.get_ref().hold[place].span();
                warnings.push(too_short(document, span, thread, &far));
            }
        }
    }
    warnings
}

fn too_short(
    document: &Document,
    span: std::ops::Range<usize>,
    thread: &Thread,
    far: &Nearest,
) -> Flaw {
    let message = format!(
        "thread {} is {:.1} mm long, and its ends are held {:.1} mm from each other at {:.2} s: it slips or breaks",
        thread.part.id,
        1e3 * thread.part.length_m,
        1e3 * far.distance_m,
        far.at_s
    );
    let help = "give the thread more `length_m`, or hold its tail nearer to its needle";
    document.warning(span, &message, "too far from the needle", help)
}

fn warning(
    document: &Document,
    span: std::ops::Range<usize>,
    what: &str,
    tool: &Tool,
    nearest: &Nearest,
) -> Flaw {
    let message = format!(
        "tool {} comes no nearer to {what} than {:.1} mm, at {:.2} s, and reaches {:.1} mm: it does not take it",
        tool.id,
        1e3 * nearest.distance_m,
        nearest.at_s,
        1e3 * tool.reach_m
    );
    let help = if tool.driven {
        "bring the hand there by a `[[hand.way_point]]`, or give the tool a longer `reach_m`"
    } else {
        "bring it there by a `[[tool.way_point]]`, or give it a longer `reach_m`"
    };
    document.warning(span, &message, "out of reach", help)
}

impl<'a> Scripts<'a> {
    fn new(
        tools: &'a [Tool],
        hand: Option<&'a HandScript>,
        needles: &[Needle],
        threads: &[Thread],
    ) -> Self {
        let used = hand.and_then(|hand| hand.way_points.get(..usize::from(hand.count)));
        let points = used.into_iter().flatten();
        let ways = tools.iter().filter_map(|tool| tool.way.as_ref());
        let holds = needles.iter().flat_map(|needle| &needle.holds);
        let thread_holds = threads.iter().flat_map(|thread| &thread.holds);
        let times = points
            .map(|point| f64::from(point.time_s))
            .chain(ways.flat_map(|way| way.stops()).map(|stop| stop.time_s))
            .chain(holds.map(|hold| hold.time_s))
            .chain(thread_holds.map(|hold| hold.time_s));
        Self {
            tools,
            hand,
            end_s: times.fold(0.0, f64::max),
        }
    }

    fn tool(&self, id: u8) -> Option<&'a Tool> {
        self.tools.iter().find(|tool| tool.id == id)
    }

    /// Where a script has a tool; `None` if there is none that says so.
    fn pose(&self, tool: &Tool, time_s: f64) -> Option<Isometry3<f64>> {
        let on_way = tool.way.as_ref().map(|way| way.at(time_s));
        let moved = on_way.and_then(|on_way| on_way.moved);
        let position_m = match (tool.driven, self.hand) {
            (true, Some(hand)) => position_at(hand, time_s),
            (true, None) => return None,
            (false, _) => moved.map_or(tool.pose?.position_m, |(at, _)| at),
        };
        let turned = on_way.map(|on_way| on_way.orientation);
        let held = tool.pose.filter(|_| !tool.driven);
        let orientation = turned.or(held.map(|pose| pose.orientation));
        let [x, y, z, w] = orientation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        Some(Isometry3::from_parts(
            Translation3::from(position_m),
            UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        ))
    }

    /// Where the needle is while it goes so.
    fn at(&self, stint: &Stint, time_s: f64) -> Option<Isometry3<f64>> {
        match stint.tool {
            Some(tool) => Some(self.pose(self.tool(tool)?, time_s)? * stint.pose),
            None => Some(stint.pose),
        }
    }

    /// Times at which is looked whether a hold from one time to another is taken \[s\].
    fn looks(&self, from_s: f64, until_s: Option<f64>) -> impl Iterator<Item = f64> + use<> {
        let length_s = (until_s.unwrap_or(self.end_s) - from_s).max(0.0);
        let every_s = EVERY_S.max(length_s / MOST_LOOKS);
        let count = (length_s / every_s).floor() as u32;
        (0..=count).map(move |look| from_s + f64::from(look) * every_s)
    }

    /// Who has a needle when, and which of its holds are not taken; the former is not known where the console's tool has it
    /// without a hand.
    fn stints(&self, needle: &Needle) -> (Option<Vec<Stint>>, Vec<Missed<'a>>) {
        let mut stints = vec![Stint {
            from_s: 0.0,
            tool: None,
            pose: needle.start,
        }];
        let mut missed = Vec::new();
        for (place, hold) in needle.holds.iter().enumerate() {
            let until_s = needle.holds.get(place + 1).map(|next| next.time_s);
            let last = &stints[stints.len() - 1];
            let Some(tool) = hold.tool.and_then(|id| self.tool(id)) else {
                let Some(pose) = self.at(last, hold.time_s) else {
                    return (None, missed);
                };
                stints.push(Stint {
                    from_s: hold.time_s,
                    tool: None,
                    pose,
                });
                continue;
            };
            let mut nearest = Nearest::none();
            let mut taken = None;
            for time_s in self.looks(hold.time_s, until_s) {
                let (Some(hand), Some(pose)) = (self.pose(tool, time_s), self.at(last, time_s))
                else {
                    return (None, missed);
                };
                let curve = needle.needle.at(&pose);
                let at = hand.translation.vector;
                nearest.look(curve.nearest(&at).metric_distance(&at), time_s);
                if nearest.distance_m <= tool.reach_m {
                    taken = Some(Stint {
                        from_s: time_s,
                        tool: Some(tool.id),
                        pose: hand.inverse() * pose,
                    });
                    break;
                }
            }
            match taken {
                Some(stint) => stints.push(stint),
                None => missed.push((place, tool, nearest)),
            }
        }
        (Some(stints), missed)
    }

    /// The first hold of a thread's tail by which its ends are farther from each other than it is long without breaking, while its needle is
    /// held and nothing has cut it, and how far they are at most.
    fn too_far(
        &self,
        thread: &Thread,
        needle: &Needle,
        stints: &[Stint],
    ) -> Option<(usize, Nearest)> {
        let part = &thread.part;
        let most_m = part.length_m * (1.0 + part.strength_n / part.through.axial_stiffness_n);
        let tails = || {
            let all = thread.holds.iter().enumerate();
            all.filter(|(_, hold)| hold.end == ThreadEnd::Tail)
        };
        let cut_s = thread.cuts.first().map_or(f64::INFINITY, |cut| cut.time_s);
        tails().find_map(|(place, hold)| {
            let next = tails().find(|(later, _)| *later > place);
            let until_s = next.map(|(_, next)| next.time_s);
            let mut far = Nearest {
                distance_m: 0.0,
                at_s: hold.time_s,
            };
            let looks = self.looks(hold.time_s, until_s);
            for time_s in looks.take_while(|time_s| *time_s < cut_s) {
                let tail = match hold.by {
                    ThreadHold::Place(at) => Vector3::from(at),
                    ThreadHold::Tool(tool) => {
                        self.pose(self.tool(tool)?, time_s)?.translation.vector
                    }
                    _ => return None,
                };
                let stint = stints.iter().rfind(|stint| stint.from_s <= time_s)?;
                if stint.tool.is_none() {
                    continue;
                }
                let end = needle.needle.at(&self.at(stint, time_s)?).start;
                let distance_m = end.metric_distance(&tail);
                if distance_m > far.distance_m {
                    far = Nearest {
                        distance_m,
                        at_s: time_s,
                    };
                }
            }
            (far.distance_m > most_m).then_some((place, far))
        })
    }

    /// Holds of a thread's ends that are not taken, as its needle has never been there.
    fn missed_threads(&self, thread: &Thread, stints: &[Stint]) -> Vec<Missed<'a>> {
        let been: Vec<(f64, Vector3<f64>)> = self
            .looks(0.0, None)
            .filter_map(|time_s| {
                let stint = stints.iter().rfind(|stint| stint.from_s <= time_s)?;
                Some((time_s, self.at(stint, time_s)?.translation.vector))
            })
            .collect();
        let mut missed = Vec::new();
        for (place, hold) in thread.holds.iter().enumerate() {
            let ThreadHold::Tool(id) = hold.by else {
                continue;
            };
            let Some(tool) = self.tool(id) else {
                continue;
            };
            let next = thread.holds[place + 1..].iter();
            let until_s = next
                .filter(|next| hold.end.is_left(hold.by, (next.end, next.by)))
                .map(|next| next.time_s);
            let mut nearest = Nearest::none();
            for time_s in self.looks(hold.time_s, until_s.reduce(f64::min)) {
                let Some(hand) = self.pose(tool, time_s) else {
                    nearest.distance_m = 0.0;
                    break;
                };
                let before = been.iter().take_while(|(then_s, _)| *then_s <= time_s);
                for (_, end) in before {
                    nearest.look(end.metric_distance(&hand.translation.vector), time_s);
                }
                if nearest.distance_m <= tool.reach_m {
                    break;
                }
            }
            if nearest.distance_m > tool.reach_m {
                missed.push((place, tool, nearest));
            }
        }
        missed
    }
}

impl Nearest {
    fn none() -> Self {
        Self {
            distance_m: f64::INFINITY,
            at_s: 0.0,
        }
    }

    fn look(&mut self, distance_m: f64, at_s: f64) {
        if distance_m < self.distance_m {
            (self.distance_m, self.at_s) = (distance_m, at_s);
        }
    }
}
