//! Takes the tip of a needle, or its end, through the cells of the tissue.
//!
//! Entry points: [`walk`], [`walk_back`]. Source: Younes 2021, algorithms 3.3 and 3.4, with the passages of
//! [`Section`](super::section::Section) in place of separate face, edge and vertex cases.

use super::history::{Crossing, History};
use super::section::{Root, Section};
use super::slide::Geometry;
use super::{Curve, tie};
use crate::mesh::{HalfFace, HalfFaces};
use nalgebra::Vector3;

/// Guessed exits in a row after which the way is lost: around one vertex there are about 30 cells.
const MOST_GUESSES: u32 = 64;

/// Why a walk ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// Where it was to go; at once if the tip is outside.
    Reached,
    /// The next crossing, not in the list, leaves the tissue.
    Boundary(Crossing),
    /// There is no room for the next crossing.
    Full,
    /// There is no way on: positions or the curve are not finite, a cell has collapsed, or the
    /// history is of another mesh.
    Lost,
}

/// What a walk did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walked {
    /// Why it ended.
    pub stop: Stop,
    /// Cells that it looked at.
    pub cells: u32,
    /// Exits taken by the direction at the cell's entry, because the curve, which the tissue may have
    /// been moved away from, does not pass through the cell.
    pub guessed: u32,
}

/// From the last crossing along `curve` to `to` \[m\], adding to `history` what lies between.
///
/// A curve leaves a cell by exactly one of its passages that lead out, or it is lost to rounding; both
/// sides of a face agree on them. Where alpha would go back, at corners met exactly or in folded
/// tissue, the crossing is put where the last one is.
pub fn walk<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    curve: &Curve,
    history: &mut History,
    to: f64,
) -> Walked {
    go(geometry, history, Heading::new(curve, false, 0.0), to)
}

/// The same from the first crossing back to `to` \[m\], with the end: [`Stop::Boundary`] is where it comes out of the tissue.
/// Of a needle without crossings, which has all of it in one cell, from `from` \[m\].
pub fn walk_back<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    curve: &Curve,
    history: &mut History,
    from: f64,
    to: f64,
) -> Walked {
    go(geometry, history, Heading::new(curve, true, -from), -to)
}

/// Along one piece of a curve, with the tip or back with the end. Back is the mirror image of forward: what counts up on the way
/// is minus alpha, and passages into a cell are those out of it.
pub(super) struct Heading<'a> {
    whole: &'a Curve,
    pub piece: Curve,
    pub section: Section,
    number: usize,
    pub back: bool,
    /// Where the piece begins on the whole \[m\].
    offset: f64,
    /// Where it begins and ends as the way counts; without end where there is no joint.
    pub span: [f64; 2],
    /// Where a way without crossings comes from.
    from: f64,
}

impl<'a> Heading<'a> {
    /// From `from` on, as the way counts.
    pub fn new(whole: &'a Curve, back: bool, from: f64) -> Self {
        let number = if back { whole.pieces() - 1 } else { 0 };
        Self::on(whole, back, from, number)
    }

    fn on(whole: &'a Curve, back: bool, from: f64, number: usize) -> Self {
        let piece = whole.piece(number);
        let [mut begins, mut ends] = piece.span;
        if number == 0 {
            begins = f64::NEG_INFINITY;
        }
        if number + 1 == whole.pieces() {
            ends = f64::INFINITY;
        }
        Self {
            whole,
            piece: piece.curve,
            section: Section::new(&piece.curve),
            number,
            back,
            offset: piece.span[0],
            span: if back {
                [-ends, -begins]
            } else {
                [begins, ends]
            },
            from,
        }
    }

    /// On to the next piece.
    pub fn next(&mut self) {
        let number = if self.back {
            self.number.saturating_sub(1)
        } else {
            self.number + 1
        };
        *self = Self::on(self.whole, self.back, self.from, number);
    }

    /// Back, or on, to the piece that has a place.
    fn seek(&mut self, along: f64) {
        let inside = self.span[0] <= along && along <= self.span[1];
        if !inside {
            let number = self.whole.number_at(self.sign() * along);
            *self = Self::on(self.whole, self.back, self.from, number);
        }
    }

    /// See [`tie`].
    pub fn tie(&self) -> f64 {
        tie(self.whole)
    }

    /// Of alpha, as the way counts.
    pub fn sign(&self) -> f64 {
        if self.back { -1.0 } else { 1.0 }
    }

    /// What counts up on the way, of alpha on the piece.
    pub fn along(&self, alpha: f64) -> f64 {
        if self.offset == 0.0 {
            self.sign() * alpha
        } else {
            self.sign() * (self.offset + alpha)
        }
    }

    /// Alpha on the piece of a place on the way.
    pub fn alpha(&self, along: f64) -> f64 {
        self.sign() * along - self.offset
    }

    fn tangent_at(&self, along: f64) -> Vector3<f64> {
        let tangent = self.piece.tangent_at(self.alpha(along));
        if self.back { -tangent } else { tangent }
    }

    /// The crossing through a half-face of the cell that the way comes from.
    pub fn crossing(
        &self,
        mesh: &HalfFaces,
        face: HalfFace,
        weights: [f64; 3],
        along: f64,
    ) -> Crossing {
        let alpha = self.sign() * along;
        let other = mesh.opposite(face).filter(|_| self.back);
        let Some(other) = other else {
            return Crossing {
                face,
                enters: self.back,
                weights,
                alpha,
            };
        };
        let own = mesh.vertices(face);
        let weight = |vertex: u32| {
            let mut each = own.iter().zip(weights);
            each.find(|(own, _)| **own == vertex)
                .map_or(0.0, |(_, weight)| weight)
        };
        Crossing {
            face: other,
            enters: false,
            weights: mesh.vertices(other).map(weight),
            alpha,
        }
    }

    /// The crossing that a way comes from.
    fn last<'h>(&self, history: &'h History) -> Option<&'h Crossing> {
        let all = history.crossings();
        if self.back { all.first() } else { all.last() }
    }

    /// Where a way is.
    pub fn cell(&self, mesh: &HalfFaces, history: &History) -> Option<u32> {
        if self.back {
            history.before()
        } else {
            history.tip_cell(mesh)
        }
    }

    /// Adds a crossing to what the way comes from.
    pub fn push(&self, history: &mut History, crossing: Crossing) -> bool {
        if self.back {
            history.push_front(crossing)
        } else {
            history.push(crossing)
        }
    }
}

/// A walk to where the way counts `to`.
pub(super) fn go<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    history: &mut History,
    mut heading: Heading,
    to: f64,
) -> Walked {
    let mesh = geometry.mesh;
    let mut walked = Walked {
        stop: Stop::Reached,
        cells: 0,
        guessed: 0,
    };
    let mut in_a_row = 0;
    while let Some(cell) = heading.cell(mesh, history) {
        walked.cells += 1;
        let last = heading.last(history).copied();
        let exit = exit(geometry, &mut heading, cell, last.as_ref(), to);
        let (face, weights, along) = match exit {
            Exit::Passage(face, weights, along) => {
                in_a_row = 0;
                (face, weights, along)
            }
            Exit::Guess(face, weights, along) => {
                in_a_row += 1;
                if along <= to {
                    walked.guessed += 1;
                }
                (face, weights, along)
            }
            Exit::Stays => break,
            Exit::Lost => {
                walked.stop = Stop::Lost;
                break;
            }
        };
        if !along.is_finite() || in_a_row > MOST_GUESSES {
            walked.stop = Stop::Lost;
            break;
        }
        if along > to {
            break;
        }
        let along = last.map_or(along, |last| along.max(heading.sign() * last.alpha));
        let crossing = heading.crossing(mesh, face, weights, along);
        if mesh.opposite(face).is_none() {
            walked.stop = Stop::Boundary(crossing);
            break;
        }
        if !heading.push(history, crossing) {
            walked.stop = Stop::Full;
            break;
        }
    }
    walked
}

enum Exit {
    /// A half-face of the cell, where on it, and where that is on the way.
    Passage(HalfFace, [f64; 3], f64),
    Guess(HalfFace, [f64; 3], f64),
    /// The cell has the whole curve in it.
    Stays,
    Lost,
}

/// Where the way leaves a cell, on the piece that it does.
fn exit<At: Fn(u32) -> Vector3<f64>>(
    geometry: &Geometry<'_, At>,
    heading: &mut Heading,
    cell: u32,
    last: Option<&Crossing>,
    to: f64,
) -> Exit {
    heading.seek(last.map_or(heading.from, |last| heading.sign() * last.alpha));
    loop {
        let Some(cell) = Cell::new(geometry, heading, cell, last) else {
            return Exit::Lost;
        };
        let exit = cell.exit(heading, to);
        let goes_on = match exit {
            Exit::Passage(.., along) | Exit::Guess(.., along) => along > heading.span[1],
            Exit::Stays | Exit::Lost => last.is_none(),
        };
        // Beyond the joint the way is another.
        if !goes_on || to <= heading.span[1] {
            return exit;
        }
        heading.next();
    }
}

/// The cell that a way is in.
struct Cell {
    /// Half-faces opposite its corners.
    faces: [HalfFace; 4],
    /// Their vertices, as places in `nodes`.
    around: [[usize; 3]; 4],
    nodes: [u32; 4],
    at: [Vector3<f64>; 4],
    heights: [f64; 4],
    entry: Option<Entry>,
}

/// The crossing that a cell was entered through.
#[derive(Clone, Copy)]
struct Entry {
    /// On the way, of where the tissue has it now; of the joint, if the way has one since.
    along: f64,
    /// Whether there is one.
    is_joint: bool,
    /// The corner of the cell that it lies opposite to.
    corner: usize,
    /// Barycentric in the cell.
    weights: [f64; 4],
}

impl Cell {
    fn new<At: Fn(u32) -> Vector3<f64>>(
        geometry: &Geometry<'_, At>,
        heading: &Heading,
        cell: u32,
        last: Option<&Crossing>,
    ) -> Option<Self> {
        let mesh = geometry.mesh;
        let faces = mesh.half_face(cell, 0)?.of_cell();
        let nodes = *mesh.cells().get(cell as usize)?;
        let at = nodes.map(|node| (geometry.at)(node));
        let section = &heading.section;
        let entry = match last {
            Some(last) => {
                let (mut weights, mut place) = ([0.0; 4], Vector3::zeros());
                // The two half-faces of a face name its vertices in different orders.
                for (vertex, weight) in mesh.vertices(last.face).into_iter().zip(last.weights) {
                    let corner = nodes.iter().position(|node| *node == vertex)?;
                    weights[corner] = weight;
                    place += at[corner] * weight;
                }
                let (was, begins) = (heading.sign() * last.alpha, heading.span[0]);
                let face = if heading.back {
                    last.face
                } else {
                    last.ahead(mesh)?
                };
                let is_joint = was < begins;
                let along = heading.along(section.alpha(&place));
                Some(Entry {
                    along: if is_joint {
                        begins
                    } else {
                        nearest(along, was, section.turn())
                    },
                    is_joint,
                    corner: face.corner(),
                    weights,
                })
            }
            None => None,
        };
        let around = faces.map(|face| {
            mesh.vertices(face)
                .map(|v| nodes.iter().position(|n| *n == v).unwrap_or(0))
        });
        Some(Self {
            faces,
            around,
            nodes,
            at,
            heights: at.map(|at| section.height(&at)),
            entry,
        })
    }

    fn roots(&self, section: &Section, corner: usize) -> [Option<Root>; 2] {
        let around = self.around[corner];
        section.roots(
            around.map(|k| self.nodes[k]),
            &around.map(|k| self.at[k]),
            &around.map(|k| self.heights[k]),
        )
    }

    fn exit(&self, heading: &Heading, to: f64) -> Exit {
        let (section, tie) = (&heading.section, heading.tie());
        let turn = section.turn();
        let from = heading.from.max(heading.span[0]);
        let entered = self.entry.map_or(from, |entry| entry.along);
        let is_joint = match self.entry {
            Some(entry) => entry.is_joint,
            None => from > heading.from,
        };
        let as_met = |root: Root| Root {
            leaves: root.leaves != heading.back,
            alpha: heading.along(root.alpha),
            ..root
        };
        let roots = [0, 1, 2, 3].map(|corner| {
            let roots = self.roots(section, corner);
            roots.map(|root| root.map(as_met))
        });
        let all = || {
            roots
                .iter()
                .enumerate()
                .flat_map(|(k, r)| r.iter().flatten().map(move |r| (k, r)))
        };
        let mut leaving = all().filter(|(_, root)| root.leaves);
        let Some(first) = leaving.next() else {
            return self.exit_without_passage(heading, to);
        };
        // Where the section has the entry: an anchor that the tissue has carried off is near it.
        let entry = self.entry.filter(|_| !is_joint);
        let entry_corner = entry.map(|entry| entry.corner);
        let found = all()
            .filter(|(corner, root)| !root.leaves && Some(*corner) == entry_corner)
            .map(|(_, root)| nearest(root.alpha, entered, turn))
            .min_by(|a, b| (a - entered).abs().total_cmp(&(b - entered).abs()));
        let start = found.unwrap_or(entered);
        // Out and in again through one face: the way out lies behind the way in, however close.
        let out_before = |corner| found.is_some() && Some(corner) == entry_corner;
        // A cell turned inside out is gone through backwards.
        let way = if turn.is_finite() && self.volume() < 0.0 {
            -1.0
        } else {
            1.0
        };
        let ahead = |corner: usize, root: &Root| {
            let ahead = way * (root.alpha - start);
            if !turn.is_finite() {
                return ahead;
            }
            // An anchor off the curve may lie behind the way out by as much as it is off.
            let slack = match found {
                Some(_) if out_before(corner) => -tie,
                Some(_) => tie,
                None if is_joint => tie,
                None => 0.5 * turn,
            };
            (ahead + slack).rem_euclid(turn) - slack
        };
        let key = |corner: usize, root: &Root| {
            let ahead = ahead(corner, root);
            let behind = out_before(corner) || ahead < -tie;
            (behind, if behind { ahead.abs() } else { ahead })
        };
        let (mut corner, mut root) = first;
        for (other_corner, other) in leaving {
            if key(other_corner, other) < key(corner, root) {
                (corner, root) = (other_corner, other);
            }
        }
        let along = start + way * ahead(corner, root);
        if along < entered - tie && self.volume() >= 0.0 {
            // The tissue has moved so that the curve leaves the cell before it enters: a place there
            // would be put where the needle is not.
            return self.exit_without_passage(heading, to);
        }
        Exit::Passage(self.faces[corner], root.weights, along)
    }

    /// Six times its volume.
    fn volume(&self) -> f64 {
        let [a, b, c, d] = self.at;
        (b - a).cross(&(c - a)).dot(&(d - a))
    }

    /// Six times the volume times the gradient of each barycentric coordinate.
    fn gradients(&self) -> [Vector3<f64>; 4] {
        // Faces are counter-clockwise from outside: the area vectors point out.
        self.around.map(|[a, b, c]| {
            let [a, b, c] = [a, b, c].map(|k| self.at[k]);
            -(b - a).cross(&(c - a))
        })
    }

    /// The curve's plane or the curve in it misses the cell: on by the tangent where it was entered.
    fn exit_without_passage(&self, heading: &Heading, to: f64) -> Exit {
        let (gradients, volume) = (self.gradients(), self.volume());
        let Some(entry) = self.entry else {
            // Nothing holds the needle in this cell; it is in it, or not.
            let tip = heading.whole.at(heading.sign() * to);
            let inside = (0..4).all(|k| {
                let corner = self.at[(k + 1) % 4];
                gradients[k].dot(&(tip - corner)) * volume.signum() >= -1e-9 * volume.abs()
            });
            return if inside && volume != 0.0 {
                Exit::Stays
            } else {
                Exit::Lost
            };
        };
        let along = heading.tangent_at(entry.along) * volume.signum();
        let rates = gradients.map(|gradient| gradient.dot(&along));
        // Back through the entry only if there is no other way.
        let others = (0..4).filter(|k| rates[*k] < 0.0 && *k != entry.corner);
        let time = |k: &usize| entry.weights[*k] * volume.abs() / -rates[*k];
        let sooner = |a: &usize, b: &usize| {
            let by_time = time(a).total_cmp(&time(b));
            by_time.then(rates[*a].total_cmp(&rates[*b]))
        };
        let back = || Some(entry.corner).filter(|k| rates[*k] < 0.0);
        let Some(corner) = others.min_by(sooner).or_else(back) else {
            return Exit::Lost;
        };
        let ahead = time(&corner);
        let per_volume = if volume == 0.0 {
            0.0
        } else {
            ahead / volume.abs()
        };
        let mut out =
            self.around[corner].map(|k| (entry.weights[k] + rates[k] * per_volume).max(0.0));
        let sum: f64 = out.iter().sum();
        out = out.map(|w| w / sum);
        if !out.iter().all(|w| w.is_finite()) {
            return Exit::Lost;
        }
        Exit::Guess(self.faces[corner], out, entry.along + ahead)
    }
}

/// The name of an angle's alpha that is nearest to another.
fn nearest(alpha: f64, to: f64, turn: f64) -> f64 {
    if turn.is_finite() {
        alpha - ((alpha - to) / turn).round() * turn
    } else {
        alpha
    }
}
