//! A thread that hangs free: inextensible, with bending, guided by points that hold it, lying on tissue.
//!
//! Entry points: [`Chain::new`], [`Chain::step`]. Of what the field uses, position-based chains (XPBD, Macklin 2016)
//! stretch by their number of sweeps and discrete elastic rods (Bergou 2008) carry a twist that a
//! suture thread, free to roll, does not need. This is the middle: implicit Euler as a minimum, of inertia, gravity,
//! drag, bending and contact, over chains of exact segment lengths. Bending is the quadratic energy of inextensible
//! rods (Bergou 2006), `EI / 2 |x''|^2`; steps are Newton's on a banded matrix of points and multipliers, each followed by a
//! way back to the lengths, and only taken if the sum falls, which bounds it for any period and stiffness. The
//! multipliers are the tension. Contact is one-sided stiffness about a thread of some radius, without friction:
//! nodes stay outside, a piece between two may cut a sharp edge. Without guides it falls.

mod band;

use super::skin::Skin;
use band::Band;
use nalgebra::Vector3;

/// Newton's steps in one step in time, unless said otherwise; two to five are usual, the rest is for what starts far away.
const MOST_NEWTON: usize = 30;
/// Halvings of one of them.
const HALVINGS: usize = 14;
/// At rest when no point would move by more than this part of a segment; a step that is held back is a small part of what is left to go.
const AT_REST: f64 = 1e-6;
/// Lengths are held this well, of their own; what is asked for is 1e-4.
const HELD: f64 = 1e-10;
/// Passes that bring lengths back, of which each squares the error.
const MOST_PASSES: usize = 40;
/// Above this error of a length a chain is laid anew from its guides before that \[1\].
const LAID_ANEW: f64 = 0.1;
/// A node nearer to a guide than this part of a segment goes with it.
const APART: f64 = 0.3;
/// A piece between guides with less slack than this, of its length, is a straight line.
const STRAIGHT: f64 = 1e-6;
/// Nodes between two guides that move freely; fewer may not reach from one to the other with their pieces.
const LEAST_FREE: usize = 3;
/// What is laid out loose leaves its line by this part of the chain's length.
const ASIDE: f64 = 0.05;
/// A force as large as what the chain pulls with presses it into tissue by this part of its radius.
const PRESSED: f64 = 0.02;

/// What a chain is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChainSettings {
    /// Its length \[m\].
    pub length_m: f64,
    /// Nodes at equal distances along it, both ends among them; at least 2.
    pub nodes: usize,
    /// Guides of a step at most.
    pub most_guides: usize,
    /// Mass per length \[kg/m\].
    pub kg_per_m: f64,
    /// Bending stiffness EI \[N m^2\].
    pub bending_n_m2: f64,
    /// Radius \[m\] by which it stays off tissue, above zero.
    pub radius_m: f64,
    /// Drag, per mass \[1/s\]: a thread in air loses its speed in about a tenth of a second.
    pub drag_per_s: f64,
    /// Gravity \[m/s^2\], (3).
    pub gravity_m_per_s2: [f64; 3],
    /// Newton's steps in one step in time at most.
    pub most_newton: usize,
}

impl ChainSettings {
    /// The same material with another radius \[m\].
    pub fn of_radius(self, radius_m: f64) -> Self {
        let ratio = radius_m / self.radius_m;
        Self {
            radius_m,
            kg_per_m: self.kg_per_m * ratio.powi(2),
            bending_n_m2: self.bending_n_m2 * ratio.powi(4),
            ..self
        }
    }

    /// Of a size 2-0 monofilament (0.3 mm of polypropylene, 1 GPa) of some length.
    pub fn of_length(length_m: f64) -> Self {
        Self {
            length_m,
            nodes: 64,
            most_guides: 128,
            kg_per_m: 65e-6,
            bending_n_m2: 4e-7,
            radius_m: 0.15e-3,
            drag_per_s: 10.0,
            gravity_m_per_s2: [0.0, 0.0, -9.81],
            most_newton: MOST_NEWTON,
        }
    }
}

/// A point that holds a chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Guide {
    /// Which point of the chain, counted from its start \[m\].
    pub along_m: f64,
    /// Where it is \[m\], (3).
    pub at_m: [f64; 3],
}

/// How a step ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum ChainStatus {
    /// In balance.
    #[default]
    Ok,
    /// Not yet: the next step goes on.
    Moving,
    /// Guides that are no numbers, beyond its ends, not ascending or too many: it stays as it is.
    Malformed,
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChainReport {
    /// How it ended.
    pub status: ChainStatus,
    /// Newton's steps.
    pub steps: u32,
    /// Largest error of a piece's length, of its own \[1\], or by what part guides are farther apart than there is of
    /// chain between them; the former is below 1e-4. Without what lies on an arc between guides so close
    /// that fewer than three nodes are there.
    pub length_error: f64,
    /// Nodes within its radius of tissue.
    pub touching: u32,
}

impl ChainReport {
    /// Of two chains: the worse status and length, steps and nodes of both.
    pub(crate) fn with(self, other: Self) -> Self {
        Self {
            status: self.status.max(other.status),
            steps: self.steps + other.steps,
            length_error: self.length_error.max(other.length_error),
            touching: self.touching + other.touching,
        }
    }
}

/// A point of the chain in a step: a node or a guide.
#[derive(Clone, Copy, Debug)]
struct Point {
    along: f64,
    /// The guide's or the node's.
    is_guide: bool,
    #[cfg_attr(not(test), expect(dead_code))]
    index: usize,
    /// Held: a guide, or a node of a straight piece.
    fixed: bool,
    mass: f64,
    /// First of its unknowns, if it is not fixed.
    first: usize,
    /// The multiplier of the piece before it, if either of its ends is free.
    multiplier: usize,
}

const NONE: usize = usize::MAX;

/// A chain, and what it needs for a step.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    settings: ChainSettings,
    /// To which side it bows where it is laid with slack; zero for downwards.
    aside: Vector3<f64>,
    /// Nodes \[m\] and their velocities \[m/s\], (n x 3).
    nodes: Vec<Vector3<f64>>,
    velocities: Vec<Vector3<f64>>,
    points: Vec<Point>,
    /// By what part guides are farther apart than there is of chain between them.
    stretched: f64,
    /// By point: where it is, was before the step, would be without forces, and is tried.
    at: Vec<Vector3<f64>>,
    before: Vec<Vector3<f64>>,
    free: Vec<Vector3<f64>>,
    trial: Vec<Vector3<f64>>,
    gradient: Vec<Vector3<f64>>,
    /// Tension of the piece before each point \[N\].
    tension: Vec<f64>,
    /// Contact of each point: depth within the radius \[m\] and the way out; of `at` and of `trial`.
    touch: Vec<(f64, Vector3<f64>)>,
    touch_tried: Vec<(f64, Vector3<f64>)>,
    /// Force of the chain on each guide \[N\], (3), by guide.
    #[cfg(test)]
    pulls: Vec<Vector3<f64>>,
    band: Band,
    rhs: Vec<f64>,
    /// Of the lengths alone: diagonal, what is next to it, right-hand side.
    lengths: Vec<[f64; 3]>,
}

/// The numbers of a step.
#[derive(Clone, Copy)]
struct Step<'a> {
    /// Half the inertia per mass and distance squared, and the drag's \[1/s^2\].
    inertia: f64,
    drag: f64,
    gravity: Vector3<f64>,
    tissue: Option<(&'a Skin, &'a [Vector3<f64>])>,
    /// Of contact \[N/m\].
    stiffness: f64,
}

impl Chain {
    /// A straight chain from `start` along `direction`; `None` for settings that make none.
    pub fn new(
        settings: ChainSettings,
        start: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<Self> {
        let positive = [settings.length_m, settings.kg_per_m, settings.radius_m];
        let least_zero = [settings.bending_n_m2, settings.drag_per_s];
        let sound = positive.iter().all(|x| x.is_finite() && *x > 0.0)
            && least_zero.iter().all(|x| x.is_finite() && *x >= 0.0)
            && settings.gravity_m_per_s2.iter().all(|x| x.is_finite())
            && settings.nodes >= 2;
        let way = direction.try_normalize(0.0)? * settings.length_m;
        let finite = way.iter().chain(start.iter()).all(|x| x.is_finite());
        if !(sound && finite) {
            return None;
        }
        let last = (settings.nodes - 1) as f64;
        let nodes: Vec<_> = (0..settings.nodes)
            .map(|node| start + way * (node as f64 / last))
            .collect();
        let most = settings.nodes + settings.most_guides;
        let vectors = || Vec::with_capacity(most);
        Some(Self {
            aside: Vector3::zeros(),
            stretched: 0.0,
            velocities: vec![Vector3::zeros(); settings.nodes],
            nodes,
            points: Vec::with_capacity(most),
            at: vectors(),
            before: vectors(),
            free: vectors(),
            trial: vectors(),
            gradient: vectors(),
            tension: Vec::with_capacity(most),
            touch: Vec::with_capacity(most),
            touch_tried: Vec::with_capacity(most),
            #[cfg(test)]
            pulls: Vec::with_capacity(settings.most_guides),
            band: Band::new(4 * most),
            rhs: Vec::with_capacity(4 * most),
            lengths: Vec::with_capacity(most),
            settings,
        })
    }

    /// Lays it at rest along straight lines from guide to guide, ascending along it, and beyond the first and the last one along
    /// `loose`, a unit vector, a little downwards or aside so that it does not stand on its end.
    pub fn place(&mut self, guides: &[Guide], loose: &Vector3<f64>) {
        let (Some(first), Some(last)) = (guides.first(), guides.last()) else {
            return;
        };
        let (segment, aside) = (self.segment(), self.falls(loose));
        let at = |guide: &Guide| Vector3::from(guide.at_m);
        let beyond = |guide: &Guide, along: f64| {
            let far = (along - guide.along_m).abs();
            at(guide) + loose * far + aside * (far * far)
        };
        for (node, place) in self.nodes.iter_mut().enumerate() {
            let along = node as f64 * segment;
            let next = guides.partition_point(|guide| guide.along_m <= along);
            let before = next.checked_sub(1).map(|before| &guides[before]);
            *place = match (before, guides.get(next)) {
                (Some(a), Some(b)) => {
                    let share = (along - a.along_m) / (b.along_m - a.along_m);
                    at(a).lerp(&at(b), share)
                }
                (None, _) => beyond(first, along),
                (_, None) => beyond(last, along),
            };
        }
        self.velocities.fill(Vector3::zeros());
    }

    /// To which side it bows from now on where it is laid between guides with slack; zero for downwards.
    pub fn bow_towards(&mut self, aside: Vector3<f64>) {
        self.aside = aside;
    }

    /// Has another length from now on, above zero \[m\], with as many nodes at equal distances.
    pub fn lengthen(&mut self, length_m: f64) {
        self.settings.length_m = length_m;
    }

    /// Has another length from now on, above zero \[m\], and so many nodes, at least 2: each is and moves as what was at `place`
    /// among the nodes of before. Takes new memory where there are more.
    pub fn renew(&mut self, length_m: f64, nodes: usize, place: impl Fn(usize) -> f64) {
        let last = (self.nodes.len() - 1) as f64;
        let of = |from: &[Vector3<f64>]| {
            let at = |node| {
                let place = place(node).clamp(0.0, last);
                let before = (place as usize).min(from.len() - 2);
                from[before].lerp(&from[before + 1], place - before as f64)
            };
            (0..nodes).map(at).collect()
        };
        (self.nodes, self.velocities) = (of(&self.nodes), of(&self.velocities));
        (self.settings.length_m, self.settings.nodes) = (length_m, nodes);
    }

    /// Where a node is along it \[m\].
    pub fn along_m(&self, node: usize) -> f64 {
        (node as f64 * self.segment()).min(self.settings.length_m)
    }

    /// Where its nodes are \[m\], from its start.
    pub fn nodes_m(&self) -> &[Vector3<f64>] {
        &self.nodes
    }

    /// Force of the chain on a guide of the last step \[N\], (3); zero for one that was not there. Pieces straight between two
    /// guides have a tension that follows from neither, and none here.
    #[cfg(test)]
    fn pull_n(&self, guide: usize) -> Vector3<f64> {
        self.pulls
            .get(guide)
            .copied()
            .unwrap_or_else(Vector3::zeros)
    }

    /// Mass of the heaviest node \[kg\].
    fn heaviest(&self) -> f64 {
        let masses = self.points.iter().map(|point| point.mass);
        masses.fold(0.0, f64::max)
    }

    /// What acts in a step of `dt_s` \[s\], and by how much a Newton step is held back where it would go too far \[N/m\].
    fn stage<'t>(
        &self,
        dt_s: f64,
        tissue: Option<(&'t Skin, &'t [Vector3<f64>])>,
    ) -> (Step<'t>, f64) {
        let settings = self.settings;
        let inertia = 1.0 / (dt_s * dt_s);
        let gravity = Vector3::from(settings.gravity_m_per_s2);
        let mut step = Step {
            inertia,
            drag: settings.drag_per_s / dt_s,
            gravity,
            tissue,
            stiffness: 0.0,
        };
        let heaviest = self.heaviest();
        let segment = settings.length_m / (settings.nodes - 1) as f64;
        let pull = self
            .tension
            .iter()
            .fold(0.0f64, |most, pull| most.max(pull.abs()));
        let load = pull
            + settings.kg_per_m * settings.length_m * gravity.norm()
            + settings.bending_n_m2 / (segment * segment);
        step.stiffness = load / (PRESSED * settings.radius_m) + 10.0 * heaviest * inertia;
        let firmness = heaviest * gravity.norm() / segment + load / settings.length_m;
        (step, firmness)
    }

    /// Moves on by `dt_s`, above zero, with `guides` ascending along the chain, and outside the tissue whose skin has its nodes at the
    /// given places. What is straight between guides stays so. Allocates nothing.
    pub fn step(
        &mut self,
        dt_s: f64,
        guides: &[Guide],
        tissue: Option<(&Skin, &[Vector3<f64>])>,
    ) -> ChainReport {
        let mut report = ChainReport {
            status: ChainStatus::Malformed,
            steps: 0,
            length_error: 0.0,
            touching: 0,
        };
        if !(self.are_sound(guides) && dt_s > 0.0 && dt_s.is_finite()) {
            return report;
        }
        self.lay(dt_s, guides);
        let (step, firmness) = self.stage(dt_s, tissue);
        self.trial.clone_from(&self.at);
        self.come_back();
        self.at.copy_from_slice(&self.trial);
        let mut sum = self.potential(&step);
        std::mem::swap(&mut self.touch, &mut self.touch_tried);
        // Where inertia is little, what a step may do is bounded at first; elsewhere where one fails.
        let segment = self.settings.length_m / (self.settings.nodes - 1) as f64;
        let mut firm = if self.heaviest() * step.inertia < firmness {
            firmness
        } else {
            0.0
        };
        report.status = ChainStatus::Moving;
        while (report.steps as usize) < self.settings.most_newton {
            report.steps += 1;
            let Some((slope, farthest)) = self.newton(&step, firm) else {
                firm = (10.0 * firm).max(firmness);
                continue;
            };
            if farthest <= AT_REST * segment {
                report.status = ChainStatus::Ok;
                break;
            }
            let mut share = self.clear_share(&step, farthest);
            let mut taken = false;
            for _ in 0..HALVINGS {
                self.go(share);
                self.come_back();
                let next = self.potential(&step);
                let rounding = 1e-15 * (sum.abs() + next.abs());
                if next <= sum + 1e-4 * share * slope + rounding {
                    sum = next;
                    taken = true;
                    break;
                }
                share *= 0.5;
            }
            if !taken {
                firm = (10.0 * firm).max(firmness);
                continue;
            }
            if share == 1.0 {
                firm *= 0.1;
            }
            std::mem::swap(&mut self.at, &mut self.trial);
            std::mem::swap(&mut self.touch, &mut self.touch_tried);
        }
        #[cfg(test)]
        self.find_pulls(&step, guides.len());
        // Speeds are those of the balance; short of it they may not have more energy than there was.
        let most_j = match report.status {
            ChainStatus::Ok => f64::INFINITY,
            _ => self.energy_left_j(&step),
        };
        self.take_over(dt_s, most_j);
        self.trial.copy_from_slice(&self.at);
        report.length_error = self.worst().max(self.stretched);
        report.touching = self.touch.iter().filter(|touch| touch.0 > 0.0).count() as u32;
        report
    }
}

mod dynamics;
mod laying;

#[cfg(test)]
mod tests;
