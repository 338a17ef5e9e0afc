//! Takes the tip of a needle through the cells of the tissue.
//!
//! Entry point: [`walk`]. Source: Younes 2021, algorithms 3.3 and 3.4, with the passages of
//! [`Section`](super::section::Section) in place of separate face, edge and vertex cases.

use super::history::{Crossing, History};
use super::section::{Root, Section};
use super::slide::Geometry;
use super::{Curve, tie};
use crate::mesh::HalfFace;
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
    let section = Section::new(curve);
    let mut walked = Walked {
        stop: Stop::Reached,
        cells: 0,
        guessed: 0,
    };
    let mut in_a_row = 0;
    while let Some(cell) = history.tip_cell(geometry.mesh) {
        walked.cells += 1;
        let last = history.crossings().last().copied();
        let exit = match Cell::new(geometry, &section, cell, last.as_ref()) {
            Some(cell) => cell.exit(curve, &section, to),
            None => Exit::Lost,
        };
        let exit = match exit {
            Exit::Passage(exit) => {
                in_a_row = 0;
                exit
            }
            Exit::Guess(exit) => {
                in_a_row += 1;
                if exit.alpha <= to {
                    walked.guessed += 1;
                }
                exit
            }
            Exit::Stays => break,
            Exit::Lost => {
                walked.stop = Stop::Lost;
                break;
            }
        };
        if !exit.alpha.is_finite() || in_a_row > MOST_GUESSES {
            walked.stop = Stop::Lost;
            break;
        }
        if exit.alpha > to {
            break;
        }
        let alpha = last.map_or(exit.alpha, |last| exit.alpha.max(last.alpha));
        let exit = Crossing { alpha, ..exit };
        if exit.leaves(geometry.mesh) {
            walked.stop = Stop::Boundary(exit);
            break;
        }
        if !history.push(exit) {
            walked.stop = Stop::Full;
            break;
        }
    }
    walked
}

enum Exit {
    Passage(Crossing),
    Guess(Crossing),
    /// The cell has the whole curve in it.
    Stays,
    Lost,
}

/// The cell that the tip is in.
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
    /// Of where the tissue has it now.
    alpha: f64,
    /// The corner of the cell that it lies opposite to.
    corner: usize,
    /// Barycentric in the cell.
    weights: [f64; 4],
}

impl Cell {
    fn new<At: Fn(u32) -> Vector3<f64>>(
        geometry: &Geometry<'_, At>,
        section: &Section,
        cell: u32,
        last: Option<&Crossing>,
    ) -> Option<Self> {
        let mesh = geometry.mesh;
        let faces = mesh.half_face(cell, 0)?.of_cell();
        let nodes = *mesh.cells().get(cell as usize)?;
        let at = nodes.map(|node| (geometry.at)(node));
        let entry = match last {
            Some(last) => {
                let (mut weights, mut place) = ([0.0; 4], Vector3::zeros());
                // The two half-faces of a face name its vertices in different orders.
                for (vertex, weight) in mesh.vertices(last.face).into_iter().zip(last.weights) {
                    let corner = nodes.iter().position(|node| *node == vertex)?;
                    weights[corner] = weight;
                    place += at[corner] * weight;
                }
                Some(Entry {
                    alpha: nearest(section.alpha(&place), last.alpha, section.turn()),
                    corner: last.ahead(mesh)?.corner(),
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

    fn exit(&self, curve: &Curve, section: &Section, to: f64) -> Exit {
        let turn = section.turn();
        let entered = self.entry.map_or(0.0, |entry| entry.alpha);
        let roots = [0, 1, 2, 3].map(|corner| self.roots(section, corner));
        let all = || {
            roots
                .iter()
                .enumerate()
                .flat_map(|(k, r)| r.iter().flatten().map(move |r| (k, r)))
        };
        let mut leaving = all().filter(|(_, root)| root.leaves);
        let Some(first) = leaving.next() else {
            return self.exit_without_passage(curve, to);
        };
        // Where the section has the entry: an anchor that the tissue has carried off is near it.
        let entry_corner = self.entry.map(|entry| entry.corner);
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
                Some(_) if out_before(corner) => -tie(curve),
                Some(_) => tie(curve),
                None => 0.5 * turn,
            };
            (ahead + slack).rem_euclid(turn) - slack
        };
        let key = |corner: usize, root: &Root| {
            let ahead = ahead(corner, root);
            let behind = out_before(corner) || ahead < -tie(curve);
            (behind, if behind { ahead.abs() } else { ahead })
        };
        let (mut corner, mut root) = first;
        for (other_corner, other) in leaving {
            if key(other_corner, other) < key(corner, root) {
                (corner, root) = (other_corner, other);
            }
        }
        let alpha = start + way * ahead(corner, root);
        if alpha < entered - tie(curve) && self.volume() >= 0.0 {
            // The tissue has moved so that the curve leaves the cell before it enters: a place there
            // would be put where the needle is not.
            return self.exit_without_passage(curve, to);
        }
        Exit::Passage(Crossing {
            face: self.faces[corner],
            enters: false,
            weights: root.weights,
            alpha,
        })
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
    fn exit_without_passage(&self, curve: &Curve, to: f64) -> Exit {
        let (gradients, volume) = (self.gradients(), self.volume());
        let Some(entry) = self.entry else {
            // Nothing holds the needle in this cell; it is in it, or not.
            let tip = curve.at(to);
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
        let along = curve.tangent_at(entry.alpha) * volume.signum();
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
        Exit::Guess(Crossing {
            face: self.faces[corner],
            enters: false,
            weights: out,
            alpha: entry.alpha + ahead,
        })
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
