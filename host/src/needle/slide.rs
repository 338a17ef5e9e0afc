//! Finds where a curve enters the tissue, and slides a needle along itself in and out of it.
//!
//! Entry points: [`entry`], [`slide`]. Source: Younes 2021, 3.2.1 and 3.2.3.1 (the playback, where boundaries
//! do not resist).

use super::Curve;
use super::hierarchy::{Capsule, Hierarchy, Slack};
use super::history::{Crossing, History};
use super::section::Root;
use super::walk::{Heading, Stop, go};
use crate::mesh::HalfFaces;
use nalgebra::Vector3;

/// Of a circle this much is taken as one straight piece when boxes are asked \[rad\]: bulging 2 % of its
/// length.
const PIECE: f64 = 0.16;

/// Tissue, and where it is.
#[derive(Clone, Copy, Debug)]
pub struct Geometry<'a, At> {
    /// Who is next to whom.
    pub mesh: &'a HalfFaces,
    /// Around the boundary, where it was when this was last made or refitted.
    pub hierarchy: &'a Hierarchy,
    /// No vertex of the boundary is farther than this from where `hierarchy` has it.
    pub slack: Slack<'a>,
    /// Where a vertex is now \[m\].
    pub at: At,
}

/// Where a curve enters the tissue, and what finding it took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// The first crossing from outside, if there is one.
    pub crossing: Option<Crossing>,
    /// Boxes of the hierarchy looked at.
    pub boxes: u32,
    /// Boundary faces looked at.
    pub faces: u32,
}

/// The first boundary face that `curve` enters the tissue through with alpha from `from` to `to` \[m\]; over
/// a whole turn at most.
///
/// `from` is tied to: what lies behind it by no more than rounding counts, so that nothing is missed between one
/// call and the next, unless it is among `history`'s last crossings and so has been entered before. Of two
/// that are tied the face with the lower number is taken.
pub fn entry<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    curve: &Curve,
    history: &History,
    from: f64,
    to: f64,
) -> Entry {
    meet(
        geometry,
        Heading::new(curve, false, from),
        history,
        [from, to],
    )
}

/// The same along a heading: back from a place outside it is the first face that the needle's end comes to.
fn meet<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    mut heading: Heading,
    history: &History,
    [from, to]: [f64; 2],
) -> Entry {
    let mut found = Entry {
        crossing: None,
        boxes: 0,
        faces: 0,
    };
    let tie = heading.tie();
    let from = from - tie;
    loop {
        let [begins, ends] = heading.span;
        if from <= ends {
            let range = [from.max(begins - tie), to.min(ends)];
            meet_piece(geometry, &heading, history, range, &mut found);
        }
        if found.crossing.is_some() || to <= ends || !from.is_finite() {
            return found;
        }
        heading.next();
    }
}

/// The first face that is met on one piece, from one place on the way to another.
fn meet_piece<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    heading: &Heading,
    history: &History,
    [from, to]: [f64; 2],
    found: &mut Entry,
) {
    let (section, tie) = (&heading.section, heading.tie());
    let curvature = heading.piece.curvature.abs();
    let to = to.min(from + section.turn());
    let pieces = ((to - from) * curvature / PIECE).ceil().max(1.0);
    if !(from <= to && pieces.is_finite()) {
        return;
    }
    let piece = (to - from) / pieces;
    let bulge = piece * piece * curvature / 8.0;
    for number in 0..pieces as u32 {
        let start = from + piece * f64::from(number);
        let [a, b] = [start, start + piece].map(|along| heading.piece.at(heading.alpha(along)));
        let capsule = Capsule::new(&a, &b);
        let (mut best, mut faces) = (found.crossing, 0);
        found.boxes += geometry.hierarchy.near(
            |bounds, group| capsule.meets(bounds, geometry.slack.of(group) + bulge + tie),
            |face| {
                faces += 1;
                let nodes = geometry.mesh.vertices(face);
                let corners = nodes.map(|node| (geometry.at)(node));
                let heights = corners.map(|at| section.height(&at));
                let roots = section.roots(nodes, &corners, &heights);
                let leads_in = |root: &Root| root.leaves == heading.back;
                for root in roots.into_iter().flatten().filter(leads_in) {
                    let (turn, along) = (section.turn(), heading.along(root.alpha));
                    let along = if turn.is_finite() {
                        from + (along - from).rem_euclid(turn)
                    } else {
                        along
                    };
                    let crossing = Crossing {
                        face,
                        enters: !heading.back,
                        weights: root.weights,
                        alpha: heading.sign() * along,
                    };
                    let between = from <= along && along <= to;
                    if between
                        && !heading.has(history, &crossing, tie)
                        && heading.sooner(&crossing, best, tie)
                    {
                        best = Some(crossing);
                    }
                }
            },
        );
        found.faces += faces;
        found.crossing = best;
        let along = |best: Crossing| heading.sign() * best.alpha;
        if best.is_some_and(|best| along(best) + tie < start + piece) {
            break;
        }
    }
}

impl Heading<'_> {
    /// Whether the needle has come through this already.
    fn has(&self, history: &History, crossing: &Crossing, tie: f64) -> bool {
        let near = |c: &&Crossing| (c.alpha - crossing.alpha).abs() <= 2.0 * tie;
        let same = |c: &Crossing| c.face == crossing.face && c.enters == crossing.enters;
        let all = history.crossings().iter();
        if self.back {
            let first = all.take_while(|c| c.alpha <= crossing.alpha + 2.0 * tie);
            first.filter(near).any(same)
        } else {
            let last = all
                .rev()
                .take_while(|c| c.alpha >= crossing.alpha - 2.0 * tie);
            last.filter(near).any(same)
        }
    }

    fn sooner(&self, crossing: &Crossing, best: Option<Crossing>, tie: f64) -> bool {
        best.is_none_or(|best| {
            let behind = self.sign() * (crossing.alpha - best.alpha);
            behind < -tie || (behind <= tie && crossing.face < best.face)
        })
    }
}

/// What a slide did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlideReport {
    /// Crossings that the tip has come through.
    pub pushed: u32,
    /// Crossings that it has been withdrawn from.
    pub popped: u32,
    /// Of those pushed, how many from outside.
    pub entered: u32,
    /// Of those pushed, how many to the outside.
    pub left: u32,
    /// Of those pushed, how many by direction only ([`Walked::guessed`](super::Walked::guessed)).
    pub guessed: u32,
    /// Whether the list goes on to the tip.
    pub status: SlideStatus,
    /// Cells, boxes and boundary faces looked at.
    pub looked_at: u32,
}

/// How a slide ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SlideStatus {
    /// The list goes to the tip.
    #[default]
    Ok,
    /// It ends short of the tip, as there is no room.
    Full,
    /// It ends short of the tip, as there is no way on ([`Stop::Lost`]).
    Lost,
    /// It is as it was: the curve or the way was not finite.
    NotFinite,
}

fn is_finite(curve: &Curve) -> bool {
    let vectors = [curve.start, curve.tangent, curve.inward];
    vectors.iter().flatten().all(|x| x.is_finite())
        && curve.curvature.is_finite()
        && curve.length.is_finite()
}

/// Slides a needle along itself by `sigma` \[m\], forward if positive, to `curve`, through tissue that does not
/// move and boundaries that do not resist.
///
/// What the list has behind the end is a thread's, and comes back as the needle is drawn back. Where it has nothing there the
/// end finds its own way, as the tip does forward.
pub fn slide<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    curve: &Curve,
    history: &mut History,
    sigma: f64,
) -> SlideReport {
    let mut report = SlideReport::default();
    if !(sigma.is_finite() && is_finite(curve)) {
        report.status = SlideStatus::NotFinite;
        return report;
    }
    history.shift(-sigma);
    if sigma > 0.0 {
        report.popped = history.pop_beyond(curve.length) as u32;
        let from = curve.length - sigma;
        let heading = || Heading::new(curve, false, 0.0);
        go_on(
            geometry,
            heading,
            history,
            [from, curve.length],
            &mut report,
        );
        return report;
    }
    let is_followed = history.crossings().len() > history.on_needle().len();
    if sigma < 0.0 && !is_followed {
        let first = history.crossings().first();
        let from = first.map_or(sigma, |first| (-first.alpha).max(sigma));
        let heading = || Heading::new(curve, true, sigma);
        go_on(geometry, heading, history, [from, 0.0], &mut report);
    }
    report.popped = history.pop_beyond(curve.length) as u32;
    report
}

impl SlideReport {
    /// Adds a crossing through a boundary face, if there is room.
    fn add(
        &mut self,
        mesh: &HalfFaces,
        heading: &Heading,
        history: &mut History,
        crossing: Crossing,
    ) {
        if heading.push(history, crossing) {
            self.pushed += 1;
            self.entered += u32::from(crossing.enters);
            self.left += u32::from(crossing.leaves(mesh));
        } else {
            self.status = SlideStatus::Full;
        }
    }
}

/// On from where the history has the needle along a heading, to `to`; outside from `from` on.
fn go_on<'a, At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    heading: impl Fn() -> Heading<'a>,
    history: &mut History,
    [mut from, to]: [f64; 2],
    report: &mut SlideReport,
) {
    loop {
        if heading().cell(geometry.mesh, history).is_none() {
            let found = meet(geometry, heading(), history, [from, to]);
            report.looked_at += found.boxes + found.faces;
            let Some(crossing) = found.crossing else {
                return;
            };
            report.add(geometry.mesh, &heading(), history, crossing);
            if report.status != SlideStatus::Ok {
                return;
            }
        }
        let had = history.crossings().len();
        let walked = go(geometry, history, heading(), to);
        report.looked_at += walked.cells;
        report.guessed += walked.guessed;
        report.pushed += (history.crossings().len() - had) as u32;
        match walked.stop {
            Stop::Reached => return,
            Stop::Boundary(crossing) => {
                from = heading().sign() * crossing.alpha;
                report.add(geometry.mesh, &heading(), history, crossing);
            }
            Stop::Full => report.status = SlideStatus::Full,
            Stop::Lost => report.status = SlideStatus::Lost,
        }
        if report.status != SlideStatus::Ok {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{TetMesh, slab};
    use crate::needle::{Needle, NeedleShape};
    use nalgebra::{Isometry3, UnitQuaternion};

    fn down(length_m: f64, tip_z: f64) -> Curve {
        let needle = Needle {
            shape: NeedleShape::Straight { length_m },
            thickness_m: 1e-3,
        };
        let turned =
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        needle.at(&Isometry3::from_parts(
            Vector3::new(0.003, 0.0011, tip_z + length_m).into(),
            turned,
        ))
    }

    fn at(mesh: &TetMesh) -> impl Fn(u32) -> Vector3<f64> + '_ {
        |node| Vector3::from(mesh.points_m()[node as usize])
    }

    #[test]
    fn a_needle_goes_through_a_slab_and_comes_back() {
        let mesh = slab([0.02, 0.02, 0.01], [4, 4, 4]).expect("a slab");
        let hierarchy = Hierarchy::new(mesh.half_faces(), at(&mesh));
        let geometry = Geometry {
            mesh: mesh.half_faces(),
            hierarchy: &hierarchy,
            slack: Slack::Everywhere(0.0),
            at: at(&mesh),
        };
        let mut history = History::new(64);
        // The slab's top is z = 0; the tip ends 2 mm below its bottom.
        let mut counts = Vec::new();
        let (mut tip, mut entered, mut left) = (0.0015, 0, 0);
        for (sigma, inside) in [
            (1e-3, false),
            (3e-3, true),
            (9.5e-3, false),
            (-9.5e-3, true),
            (-4e-3, false),
        ] {
            tip -= sigma;
            let report = slide(&geometry, &down(0.03, tip), &mut history, sigma);
            assert_eq!(report.status, SlideStatus::Ok);
            assert_eq!(report.guessed, 0);
            assert_eq!(history.check(mesh.half_faces(), 0.03), Ok(()));
            assert_eq!(history.tip_cell(mesh.half_faces()).is_some(), inside);
            (entered, left) = (entered + report.entered, left + report.left);
            counts.push(history.crossings().len());
            for crossing in history.crossings() {
                let nodes = mesh.half_faces().vertices(crossing.face);
                let on_face: Vector3<f64> = std::iter::zip(nodes, crossing.weights)
                    .map(|(node, weight)| at(&mesh)(node) * weight)
                    .sum();
                let off = on_face - down(0.03, tip).at(crossing.alpha);
                assert!(off.norm() < 1e-16, "{off}");
            }
        }
        assert_eq!((entered, left), (1, 1));
        assert_eq!((counts[0], counts[4]), (0, 0));
        assert!(
            counts[1] >= 2 && counts[1] == counts[3] && counts[2] > 8,
            "{counts:?}"
        );
    }
}
