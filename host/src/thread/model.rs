//! What is constant about a scene's threads, and what a step reports of them.
//!
//! Entry points: [`ThreadPart`], [`ThreadReport`].

use super::lap::Contact;
use super::segments::Ground;
use crate::mesh::HalfFaces;
use serde::Serialize;
use std::fmt;
use thiserror::Error;

/// A thread of a model, fastened to the end of a needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadPart {
    /// Names it.
    pub id: u8,
    /// Id of the needle whose end its head is fastened to.
    pub needle: u8,
    /// Its length \[m\].
    pub length_m: f64,
    /// Coulomb's coefficient against tissue \[1\]: tension falls by e^(friction turn) where it slides around
    /// a turn (capstan).
    pub friction: f64,
    /// Tension that it bears \[N\]; beyond that it breaks.
    pub strength_n: f64,
    /// How it stretches, drags, slips and presses.
    pub through: Through,
}

/// Of the one length that runs through outside spans and paths inside tissue. Along the path
/// dT/ds = drag + friction |curvature| T.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Through {
    /// EA, tension over strain \[N\]; infinite if it does not stretch.
    pub axial_stiffness_n: f64,
    /// Drag of tissue along it, per length in tissue \[N/m\].
    pub drag_n_per_m: f64,
    /// What a tool's grip holds before the thread slips through it \[N\]; may be infinite.
    pub grip_n: f64,
    /// What a knot holds before it opens \[N\]; may be infinite.
    pub knot_n: f64,
    /// Diameter, over which it presses on tissue \[m\].
    pub thickness_m: f64,
    /// Pressure on tissue above which that tears \[Pa\], which is warned of and does not happen; infinite for none.
    pub tear_pa: f64,
    /// Strands that there are at one time at most: one, and one more for each hand between the ends and each cut.
    pub strands: u8,
    /// Whether taut spans outside keep out of the tissue within each balance; else they do so by the next one, where they
    /// would bend sharply.
    pub body: bool,
}

/// Diameter of a thread that does not say \[m\]: USP 2-0.
const THICKNESS_M: f64 = 0.3e-3;

impl Default for Through {
    /// Inextensible, without drag, in grips and knots that do not give way; of 0.3 mm, and with room for one hand between the ends.
    fn default() -> Self {
        Self {
            axial_stiffness_n: f64::INFINITY,
            drag_n_per_m: 0.0,
            grip_n: f64::INFINITY,
            knot_n: f64::INFINITY,
            thickness_m: THICKNESS_M,
            tear_pa: f64::INFINITY,
            strands: 2,
            body: false,
        }
    }
}

impl ThreadPart {
    /// Half of its thickness \[m\].
    pub fn radius_m(&self) -> f64 {
        0.5 * self.through.thickness_m
    }

    /// Whether tissue holds it back where it slides.
    pub(crate) fn rubs(&self) -> bool {
        self.friction > 0.0 || self.drags()
    }

    /// Whether tissue holds it back without tension, too.
    pub(crate) fn drags(&self) -> bool {
        self.through.drag_n_per_m > 0.0
    }
}

/// A body that a thread may lie on, or another body press on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThreadBody {
    /// The bar of a grip, by the id of the tool.
    Grip(u8),
    /// The shaft of a needle that has a body, by the id of the needle.
    Needle(u8),
}

impl fmt::Display for ThreadBody {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Grip(tool) => write!(f, "the body of tool {tool}"),
            Self::Needle(needle) => write!(f, "the body of needle {needle}"),
        }
    }
}

/// A thread and a body that it may lie on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThreadContact {
    /// Id of the thread.
    pub thread: u8,
    /// What its taut spans lie on.
    pub with: ThreadBody,
}

/// What holds one of a thread's ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub enum ThreadHold {
    /// Nothing: it is drawn into the tissue without effort.
    #[default]
    Free,
    /// A knot that is too thick for the first puncture.
    Knot,
    /// A place \[m\], (3).
    Place([f64; 3]),
    /// The grip of a tool, by its id, which takes hold of it without slack at the nearest face.
    Tool(u8),
    /// Nothing any more, if it was the grip of this tool; other hands stay. Of the head or a span.
    Without(u8),
}

/// Which end of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ThreadEnd {
    /// The one that follows.
    Tail,
    /// The one at the needle, between it and the last face. Held by nothing it is held by the needle.
    Head,
    /// No end: what is outside, where it is nearest to the hand. A hand there, or at the head, divides the thread into strands, of which
    /// each has a length and a tension of its own. Several hands can be there; one that takes another place lets go of the one that it
    /// had, and a hold by nothing lets go of all.
    Span,
}

impl ThreadEnd {
    /// Whether who holds it, `by`, does so no more when the next takes hold.
    pub(crate) fn is_left(self, by: ThreadHold, (end, next): (Self, ThreadHold)) -> bool {
        let lets_go = matches!(next, ThreadHold::Without(_));
        match (self, end) {
            (Self::Tail, Self::Tail) => true,
            (Self::Head, Self::Head) if !lets_go => true,
            (Self::Tail, _) | (_, Self::Tail) => false,
            _ => match (by, next) {
                (_, ThreadHold::Free) => true,
                (ThreadHold::Tool(tool), ThreadHold::Without(other)) => tool == other,
                _ => next == by,
            },
        }
    }
}

/// How short hands make spans that bridge two bodies of tissue: there is thread in each for a part of its length in the unloaded mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tightening {
    /// To which part before, and in the end.
    pub ratio: [f64; 2],
    /// How much of that is done, 0 to 1.
    pub done: f64,
    /// Whether one span comes after the other, from the tail on, instead of all together.
    pub in_turn: bool,
    /// Tension in a span at which its hand draws no further \[N\]; may be infinite.
    pub most_n: f64,
}

impl Tightening {
    /// Of the span at `place` among `count`.
    pub fn of(&self, place: usize, count: usize) -> f64 {
        let [from, to] = self.ratio;
        from + self.done_of(place, count) * (to - from)
    }

    /// Whether a hand has that span.
    pub(crate) fn has_begun(&self, place: usize, count: usize) -> bool {
        self.ratio[0] < 1.0 || self.done_of(place, count) > 0.0
    }

    /// How much is done of it, 0 to 1.
    fn done_of(&self, place: usize, count: usize) -> f64 {
        if self.in_turn {
            (self.done * count as f64 - place as f64).clamp(0.0, 1.0)
        } else {
            self.done
        }
    }

    pub(crate) fn is_sound(&self) -> bool {
        let numbers = [self.ratio[0], self.ratio[1], self.done];
        numbers.iter().all(|x| x.is_finite() && *x >= 0.0) && self.most_n > 0.0
    }
}

/// How a thread does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum ThreadTension {
    /// There is more of it than its path needs: no tension.
    #[default]
    Slack,
    /// Its path is as long as what there is of it.
    Taut,
}

/// What a step found about one thread.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThreadReport {
    /// Which thread.
    pub id: u8,
    /// Whether any of it pulls.
    pub state: ThreadTension,
    /// Whether the strands at the tail and at the head pull, which are one where no hand is between.
    pub end_state: [ThreadTension; 2],
    /// What there is of thread in them more than their paths need \[m\].
    pub slack_m: [f64; 2],
    /// Tension at the tail and at the head \[N\].
    pub tension_n: [f64; 2],
    /// The tools that hold its tail and its head, the latter through the needle or not.
    pub held_by: [Option<u8>; 2],
    /// Unit vectors along which it pulls what holds its tail and its head, (2 x 3); zero where nothing does.
    pub direction: [[f64; 3]; 2],
    /// Where it is held at tail and head \[m\], (2 x 3).
    pub end_m: [[f64; 3]; 2],
    /// Boundary faces that it goes through.
    pub punctures: u32,
    /// Length of its path, outside the tissue and inside \[m\].
    pub length_m: f64,
    /// What there is of it for that, unstretched \[m\].
    pub available_m: f64,
    /// Drawn out of the tissue so far by what holds the tail, and the head \[m\].
    pub pulled_m: [f64; 2],
    /// Slipped through the grips at tail and head so far \[m\].
    pub slipped_m: [f64; 2],
    /// Drawn out of its spans so far by hands that tighten them \[m\].
    pub drawn_m: f64,
    /// What has been broken off \[m\], if it has broken.
    pub broken_off_m: Option<f64>,
    /// Segments of no length that the tension holds closed.
    pub welds: u32,
    /// Points of tissue outside that it bends around.
    pub wraps: u32,
    /// Bodies that its spans lie on, each span counted.
    pub laps: u32,
    /// Spent by friction so far \[J\].
    pub dissipated_j: f64,
    /// Largest of [`crate::step::State::thread_pressures_pa`] \[Pa\].
    pub pressure_pa: f64,
}

/// What a step found about a hand between the ends of a thread. Pairs are of the sides of the tail and of the head.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandReport {
    /// Which thread.
    pub thread: u8,
    /// The tool, unless it is a place.
    pub tool: Option<u8>,
    /// Where it holds the thread \[m\], (3).
    pub at_m: [f64; 3],
    /// Where that is on the thread, counted from the head \[m\].
    pub along_m: f64,
    /// Tension at both sides \[N\], (2).
    pub tension_n: [f64; 2],
    /// Unit vectors along which both sides pull it, (2 x 3); zero where there is nothing.
    pub direction: [[f64; 3]; 2],
    /// What there is of thread in both strands more than their paths need \[m\], (2).
    pub slack_m: [f64; 2],
    /// Slipped through it so far to the side of the tail, and to that of the head \[m\], (2).
    pub slipped_m: [f64; 2],
}

/// A point of a thread's path, from tail to head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadPoint {
    /// Where it is \[m\], (3).
    pub at_m: [f64; 3],
    /// Where on the thread, counted from the head \[m\].
    pub along_m: f64,
    /// What it is.
    pub what: ThreadPlace,
    /// Tension between it and the next point \[N\].
    pub tension_n: f64,
}

/// What a point of a thread's path is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThreadPlace {
    /// Held, or the needle's end.
    End,
    /// In a face within the tissue.
    Inside,
    /// In a boundary face; the thread goes into the tissue there, seen from the tail.
    Enters,
    /// In a boundary face; the thread comes out of the tissue there.
    Leaves,
    /// On the surface, where it bends around it.
    Wraps,
    /// Between two points that hold it, or beyond the last one, where nothing draws it taut.
    Hangs,
    /// A loose end where it is cut or broken; the next point is of another piece.
    Cut,
}

/// A span of a thread between two punctures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bridge {
    /// Straight distance of its ends in the unloaded mesh \[m\].
    pub rest_m: f64,
    /// Its length now \[m\].
    pub now_m: f64,
    /// Tension in it \[N\].
    pub tension_n: f64,
}

/// Why threads cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ThreadError {
    /// One id for two threads.
    #[error("two threads have the id {0}")]
    SameThread(u8),
    /// A needle that is not there, or has a thread already.
    #[error("thread {id} is fastened to needle {needle}, which {flaw}")]
    Needle {
        /// Which thread.
        id: u8,
        /// Which needle.
        needle: u8,
        /// What is wrong with it.
        flaw: &'static str,
    },
    /// More strands than there is room for.
    #[error("the threads come in {0} strands; at most {MAX_STRANDS} are possible")]
    TooManyStrands(usize),
    /// A thread, or a body for it to lie on, that is not there.
    #[error("thread {} is to lie on {}, but {flaw}", contact.thread, contact.with)]
    Contact {
        /// Which of both.
        contact: ThreadContact,
        /// What is wrong with it.
        flaw: &'static str,
    },
    /// A number out of range.
    #[error("thread {id}: `{what}` is {value}; it must be {rule}")]
    Number {
        /// Which thread.
        id: u8,
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
}

/// Threads of a model, and the tissue that they go through.
#[derive(Debug)]
pub(crate) struct Threads {
    pub parts: Vec<ThreadPart>,
    /// Index of each thread's needle.
    needles: Vec<usize>,
    /// Index of the thread of each strand. The first are those at the needles, one a thread, in the order of threads.
    strands: Vec<usize>,
    /// Number of each node's connected body of tissue, (n), and how many there are.
    bodies: Vec<u32>,
    count: u32,
    /// Least distance of faces inside between which the path has a direction of its own \[m\].
    apart_m: f64,
    /// Which bodies each may lie on.
    pub contacts: Vec<Contact>,
}

/// Most segments of one thread: 50 punctures with as many bends, both ends, and four in each of 50 passages.
pub(crate) const MOST_SEGMENTS: usize = 288;
/// Most bends of one thread.
pub(crate) const MOST_BENDS: usize = 96;
/// Most strands of all threads together.
pub(crate) const MAX_STRANDS: usize = 16;
/// Most hands between the ends of all threads together.
pub(crate) const MOST_HANDS: usize = 4;

impl Threads {
    /// No threads.
    pub fn none() -> Self {
        Self {
            parts: Vec::new(),
            needles: Vec::new(),
            strands: Vec::new(),
            bodies: Vec::new(),
            count: 0,
            apart_m: 0.0,
            contacts: Vec::new(),
        }
    }

    /// Threads on needles with `ids`, in tissue made of `mesh`, in which faces count that are `apart_m` from each other.
    pub fn new(
        parts: &[ThreadPart],
        ids: &[u8],
        mesh: &HalfFaces,
        apart_m: f64,
    ) -> Result<Self, ThreadError> {
        let mut needles: Vec<usize> = Vec::with_capacity(parts.len());
        for (index, part) in parts.iter().enumerate() {
            let (id, needle) = (part.id, part.needle);
            if parts[..index].iter().any(|other| other.id == id) {
                return Err(ThreadError::SameThread(id));
            }
            let flaw = |flaw| ThreadError::Needle { id, needle, flaw };
            let place = ids.iter().position(|other| *other == needle);
            let place = place.ok_or_else(|| flaw("does not exist"))?;
            if needles.contains(&place) {
                return Err(flaw("has a thread already"));
            }
            needles.push(place);
            check_numbers(part)?;
        }
        let mut strands: Vec<usize> = (0..parts.len()).collect();
        for (index, part) in parts.iter().enumerate() {
            strands.extend((1..part.through.strands).map(|_| index));
        }
        if strands.len() > MAX_STRANDS {
            return Err(ThreadError::TooManyStrands(strands.len()));
        }
        let (bodies, count) = mesh.bodies();
        Ok(Self {
            parts: parts.to_vec(),
            needles,
            strands,
            bodies,
            count,
            apart_m,
            contacts: Vec::new(),
        })
    }

    /// The thread of a needle.
    pub fn of_needle(&self, needle: usize) -> Option<usize> {
        self.needles.iter().position(|own| *own == needle)
    }

    /// Number of strands that there can be.
    pub fn strands(&self) -> usize {
        self.strands.len()
    }

    /// Index of the thread that a strand is of.
    pub fn thread_of(&self, strand: usize) -> usize {
        self.strands[strand]
    }

    /// The thread that a strand is of.
    pub fn part_of(&self, strand: usize) -> &ThreadPart {
        &self.parts[self.strands[strand]]
    }

    /// Index of the needle of a strand's thread.
    pub fn needle_of(&self, strand: usize) -> usize {
        self.needles[self.strands[strand]]
    }

    /// Whether a strand ends at its needle.
    pub fn is_led(&self, strand: usize) -> bool {
        strand < self.parts.len()
    }

    /// What they go through.
    pub fn ground<'a>(&'a self, mesh: &'a HalfFaces, points_m: &'a [[f64; 3]]) -> Ground<'a> {
        Ground {
            mesh,
            points_m,
            bodies: &self.bodies,
            count: self.count,
            apart_m: self.apart_m,
        }
    }
}

/// Lengths, forces and coefficients of a thread.
fn check_numbers(part: &ThreadPart) -> Result<(), ThreadError> {
    let Through {
        axial_stiffness_n,
        drag_n_per_m,
        grip_n,
        knot_n,
        thickness_m,
        tear_pa,
        strands,
        body: _,
    } = part.through;
    let positive = |value: f64| (value > 0.0 && value.is_finite(), "above zero");
    // Infinite for what does not give way.
    let rigid = |value: f64| (value > 0.0, "above zero");
    let coefficient = |value: f64| ((0.0..=10.0).contains(&value), "from 0 to 10");
    let most = MAX_STRANDS as u8;
    let in_all = |strands: u8| ((1..=most).contains(&strands), "from 1 to 16");
    let drag = |value: f64| (value >= 0.0 && value.is_finite(), "zero or above");
    let numbers = [
        ("length_m", part.length_m, positive(part.length_m)),
        ("friction", part.friction, coefficient(part.friction)),
        ("strength_n", part.strength_n, positive(part.strength_n)),
        (
            "axial_stiffness_n",
            axial_stiffness_n,
            rigid(axial_stiffness_n),
        ),
        ("drag_n_per_m", drag_n_per_m, drag(drag_n_per_m)),
        ("grip_n", grip_n, rigid(grip_n)),
        ("knot_n", knot_n, rigid(knot_n)),
        ("thickness_m", thickness_m, positive(thickness_m)),
        ("tear_pa", tear_pa, rigid(tear_pa)),
        ("strands", f64::from(strands), in_all(strands)),
    ];
    for (what, value, (sound, rule)) in numbers {
        if !sound {
            return Err(ThreadError::Number {
                id: part.id,
                what,
                value,
                rule,
            });
        }
    }
    Ok(())
}
