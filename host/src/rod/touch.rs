//! Where a rod touches the surface, from one balance to the next.
//!
//! Entry points: [`Balance::look_for_touches`], [`Balance::corrected`] after a solve, [`Balance::followed`] once a balance is found. Each
//! place is a point of the tissue with the rows of a cone, which keep it outside. Where it lies and which way it looks stays while a
//! balance is solved for, unless what presses has come to overlap, and follows once it is found; what slips is plastic flow, integrated
//! backwards (Simo & Hughes 1998, 1.4).

use super::feature::{Feature, Found, Part};
use super::shape::Rod;
use crate::anchors::AnchorPoint;
use crate::boxes::Bounds;
use crate::mesh::HalfFace;
use crate::needle::{Capsule, Lie, MOST_GROUPS, Slack};
use crate::source::tool::WALL_M_PER_N;
use crate::step::{Balance, Sources};
use nalgebra::Vector3;
use serde::Serialize;

/// Most places that a rod touches at once.
pub(crate) const MOST_TOUCHES: usize = 64;
/// A rod's overlap at a balance at most, and where it is found to touch anew, in mean edges.
pub(crate) const OVERLAP: [f64; 2] = [5e-4, 1e-4];
/// So many times that what presses may be apart: what lies beside an edge of the surface would go to and fro over it.
const APART: f64 = 4.0;
/// Solves of a balance after which distances are taken as they are.
pub(crate) const CORRECTED: u32 = 16;
/// Larger coefficients of friction are as this one: it slips at 6 degrees from the surface.
const MOST_FRICTION: f64 = 10.0;
/// What is found beyond a stretch's ends by more than this part of it is the next one's.
const STRAYS: f64 = 0.05;

/// A rod where it is.
pub(crate) trait Swept {
    /// Its shape.
    fn rod(&self) -> &Rod;
    /// Whether it can touch the surface at a place on it \[m\].
    fn is_free(&self, alpha: f64) -> bool;
    /// Coulomb's coefficient on the face of a cell.
    fn friction(&self, cell: u32) -> f64;
}

/// A place where a rod touches the surface, or may come to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Touch {
    /// Names its rows.
    pub id: u32,
    pub feature: Feature,
    pub at: AnchorPoint,
    /// On the rod \[m\].
    pub alpha: f64,
    pub lie: Lie,
    pub friction: f64,
    /// Of the tissue's point from the curve, along the normal, when it touches \[m\].
    pub apart_m: f64,
    /// Force on the tissue at the last balance \[N\].
    pub force: Vector3<f64>,
}

/// Scratch: faces near a rod, and what it comes to touch.
#[derive(Default)]
pub(crate) struct TouchWork {
    near: Vec<HalfFace>,
    pub found: Vec<Touch>,
}

impl TouchWork {
    /// Nothing for a scene without rods.
    pub fn new(sources: &Sources) -> Self {
        if !sources.have_rods() {
            return Self::default();
        }
        Self {
            near: Vec::with_capacity(2 * sources.mesh.boundary().half_faces().len()),
            found: Vec::with_capacity(MOST_TOUCHES),
        }
    }
}

/// The chord of a stretch and what may stray from it, and so far around that all is that is nearer to the rod there than
/// `reach_m`.
fn around(rod: &Rod, [from, to]: [f64; 2], reach_m: f64) -> (Capsule, f64) {
    let [a, b] = [from, to].map(|alpha| rod.curve.at(alpha));
    let aside = (b - a) * STRAYS;
    // An arc leaves its chord by an eighth of its curvature times its length squared; what is longer here is for what strays.
    let long_m = (to - from) * (1.0 + 4.0 * STRAYS);
    let bulge_m = long_m * long_m * rod.curve.curvature_at(0.5 * (from + to)) / 8.0;
    let capsule = Capsule::new(&(a - aside), &(b + aside));
    (capsule, reach_m + rod.radius_m + bulge_m)
}

impl Balance<'_> {
    /// Lists the faces of the boundary that are nearer to a stretch of a rod than `reach_m`.
    fn near_stretch(&self, rod: &Rod, stretch: [f64; 2], reach_m: f64, out: &mut Vec<HalfFace>) {
        out.clear();
        let mut slack = [0.0; MOST_GROUPS];
        let slack = Slack::ByGroup(self.slack(&mut slack));
        let (capsule, reach_m) = around(rod, stretch, reach_m);
        self.sources.hierarchy.near(
            |bounds, group| capsule.meets(bounds, reach_m + slack.of(group)),
            |face| out.push(face),
        );
        out.sort_unstable();
    }

    /// Whether a rod is within `reach_m` of the surface.
    pub(crate) fn is_near_surface(&self, rod: &Rod, reach_m: f64, work: &mut TouchWork) -> bool {
        rod.stretches().any(|stretch| {
            self.near_stretch(rod, stretch, reach_m, &mut work.near);
            !work.near.is_empty()
        })
    }

    /// Adds to what is found what is nearer to a rod than `within_m` and not among its `touches`; whether there is room for all of that.
    pub(crate) fn look_for_touches(
        &self,
        swept: &impl Swept,
        touches: &[Touch],
        within_m: f64,
        work: &mut TouchWork,
    ) -> bool {
        let TouchWork { near, found } = work;
        let rod = swept.rod();
        let (most, mut has_room) = (MOST_TOUCHES - touches.len(), true);
        for stretch in rod.stretches() {
            let reach_m = within_m.max(0.0);
            self.near_stretch(rod, stretch, reach_m, near);
            let (capsule, reach_m) = around(rod, stretch, reach_m);
            for face in &*near {
                // Of those that may be near most are not where they are now.
                let nodes = self.sources.mesh.vertices(*face).into_iter();
                let bounds =
                    nodes.fold(Bounds::NOTHING, |all, node| all.with(&self.position(node)));
                if !capsule.meets(&bounds, reach_m) {
                    continue;
                }
                self.look(swept, touches, stretch, *face, |feature, there| {
                    let is_near = there.gap_m < within_m && there.gap_m > -rod.radius_m;
                    let is_new = is_near && there.is_within;
                    if is_new && !is_known(found, feature, stretch) {
                        has_room &= found.len() < most;
                        found.extend(has_room.then(|| touch(swept, feature, there)));
                    }
                });
            }
        }
        has_room
    }

    /// Visits what is not yet touched of a face by a stretch of a rod.
    fn look(
        &self,
        swept: &impl Swept,
        touches: &[Touch],
        stretch: [f64; 2],
        face: HalfFace,
        mut visit: impl FnMut(Feature, &Found),
    ) {
        let [from, to] = stretch;
        let (near, aside) = (0.5 * (from + to), STRAYS * (to - from));
        let mut look = |feature: Feature| {
            if is_known(touches, feature, stretch) {
                return;
            }
            let there = self.find(swept, feature, near);
            let own = from - aside..=to + aside;
            if let Some(there) = there.filter(|there| own.contains(&there.alpha)) {
                visit(feature, &there);
            }
        };
        let nodes = self.sources.mesh.vertices(face);
        for corner in 0..3 {
            let (a, b) = (nodes[corner], nodes[(corner + 1) % 3]);
            look(Feature::Edge([a.min(b), a.max(b)]));
            look(Feature::Vertex(a));
        }
        let rod = swept.rod();
        if from == 0.0 {
            look(Feature::Face(face, Part::End));
        }
        if to == rod.front_m {
            look(Feature::Face(face, Part::Front));
        }
        let [a, b, c] = nodes.map(|node| self.position(node));
        for number in rod.rolling(stretch, &(b - a).cross(&(c - a))) {
            look(Feature::Face(face, Part::Bulge(number)));
        }
    }

    /// Whether a point of the tissue can move.
    fn gives(&self, at: &AnchorPoint) -> bool {
        let numbering = self.body.numbering();
        let parts = at.nodes.iter().zip(at.weights);
        parts
            .filter(|(_, weight)| *weight != 0.0)
            .any(|(node, _)| !numbering.is_fixed(*node))
    }

    /// Penetration of a rod that presses on a prescribed point with `force` \[N\] \[m\]; zero for a point that can
    /// move.
    fn stretch_m(&self, at: &AnchorPoint, force: &Vector3<f64>) -> Option<Vector3<f64>> {
        (!self.gives(at)).then(|| force * WALL_M_PER_N)
    }

    /// A touch where the last solve has it, that `presses` or not, with `force` \[N\], and has slipped by so much \[m\]; nothing if
    /// that is where it lies but for `within_m`, both.
    pub(crate) fn corrected(
        &self,
        swept: &impl Swept,
        known: &Touch,
        (presses, force, slid_m): (bool, Vector3<f64>, Vector3<f64>),
        within_m: [f64; 2],
    ) -> Option<Touch> {
        let found = self.find(swept, known.feature, known.alpha)?;
        let (mut slid_m, mut gap_m) = (slid_m, found.gap_m);
        if let Some(stretch_m) = self.stretch_m(&known.at, &force) {
            slid_m += stretch_m;
            gap_m -= found.normal.dot(&stretch_m);
        }
        let is_inside = gap_m < -within_m[1] && gap_m > -swept.rod().radius_m;
        let is_off = if presses {
            !(-within_m[0]..=APART * within_m[0]).contains(&gap_m)
        } else {
            found.is_within && is_inside
        };
        if !is_off {
            return None;
        }
        if !found.is_within {
            return Some(Touch {
                apart_m: known.apart_m - gap_m,
                ..*known
            });
        }
        let mut next = known.moved(touch(swept, known.feature, &found));
        next.lie.slid_m = slid_m - found.normal * found.normal.dot(&slid_m);
        Some(next)
    }

    /// A touch where the balance has it; nothing if it has none.
    pub(crate) fn followed(&self, swept: &impl Swept, known: &Touch) -> Option<Touch> {
        let found = self.find(swept, known.feature, known.alpha)?;
        let mut next = known.moved(touch(swept, known.feature, &found));
        if let Some(stretch_m) = self.stretch_m(&found.at, &known.force) {
            next.lie.slid_m = stretch_m - found.normal * found.normal.dot(&stretch_m);
        }
        found.is_within.then_some(next)
    }
}

impl Touch {
    /// The same touch as it lies now.
    fn moved(&self, now: Self) -> Self {
        Self {
            id: self.id,
            force: self.force,
            ..now
        }
    }

    /// Whether it pressed at the last balance.
    pub fn presses(&self) -> bool {
        self.force != Vector3::zeros()
    }
}

fn touch(swept: &impl Swept, feature: Feature, found: &Found) -> Touch {
    let rod = swept.rod();
    let along = rod.curve.tangent_at(found.alpha);
    Touch {
        id: 0,
        feature,
        at: found.at,
        alpha: found.alpha,
        lie: Lie::new(found.normal, &along),
        friction: swept.friction(found.cell).min(MOST_FRICTION),
        apart_m: rod.radius_m,
        force: Vector3::zeros(),
    }
}

/// Whether a feature is among those that a stretch of a rod touches.
fn is_known(touches: &[Touch], feature: Feature, [from, to]: [f64; 2]) -> bool {
    let aside = 0.5 * (to - from);
    let own = from - aside..=to + aside;
    let mut touches = touches.iter();
    touches.any(|touch| touch.feature == feature && own.contains(&touch.alpha))
}
