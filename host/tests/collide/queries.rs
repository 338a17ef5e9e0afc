//! Things that move, in whole units: at random, planted to meet, and planted to just miss.
//!
//! Entry point: [`draw`].

use super::exact::{Kind, Point, Query};
use sutura_testkit::Random;

/// Whole numbers from a seed.
pub struct Chance(Random);

impl Chance {
    pub fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    fn below(&mut self, count: u64) -> u64 {
        self.0.below(count as usize) as u64
    }

    /// -size to size.
    fn whole(&mut self, size: i128) -> i128 {
        i128::from(self.0.bits() >> 32) * 2 * size / (1 << 32) - size
    }

    fn point(&mut self, size: i128) -> Point {
        std::array::from_fn(|_| self.whole(size))
    }
}

/// What kind of meeting was planted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// Anywhere, at any speed.
    Random,
    /// A meeting inside both, at a time within the step.
    Meeting,
    /// ... and one node shifted by little: it may or may not meet.
    Close,
    /// All of the motion in one plane, which lies aslant.
    Coplanar,
    /// On the border of a face or at the end of an edge, at a bound of the step, or passing along.
    Grazing,
    /// Nothing moves, or all of it alike, and it touches.
    Resting,
    /// A node or its position in common.
    Shared,
    /// Edges without length and faces without area.
    Degenerate,
    /// A meeting of small things, 16,000 times their size from the world's origin.
    Far,
}

pub const FAMILIES: [Family; 9] = [
    Family::Random,
    Family::Meeting,
    Family::Close,
    Family::Coplanar,
    Family::Grazing,
    Family::Resting,
    Family::Shared,
    Family::Degenerate,
    Family::Far,
];

/// A query, and the time at which it was planted to meet, in sixteenths of the step.
pub struct Drawn {
    pub query: Query,
    pub meets_at: Option<i128>,
}

/// Times and places are sixteenths, and what they divide multiples of 16.
const PARTS: i128 = 16;
/// Half the size of things \[units\].
const SIZE: i128 = 1 << 20;
/// Where far things lie \[units\].
const AWAY: Point = [1 << 28, -(1 << 28), 1 << 27];

pub fn draw(chance: &mut Chance, family: Family) -> Drawn {
    let kind = if chance.below(2) == 0 {
        Kind::VertexFace
    } else {
        Kind::EdgeEdge
    };
    // At a sixteenth and at a thousandth of the size, too.
    let speed = (SIZE / PARTS) >> [0, 0, 4, 10][chance.below(4) as usize];
    let time = match family {
        Family::Grazing => [0, PARTS, i128::from(chance.below(17))][chance.below(3) as usize],
        _ => i128::from(chance.below(17)),
    };
    let mut at = met(chance, kind, family);
    let mut moves: [Point; 4] = std::array::from_fn(|_| scaled(&chance.point(speed), PARTS));
    match family {
        Family::Random => {
            at = std::array::from_fn(|_| chance.point(SIZE));
        }
        Family::Resting => {
            let alike = if chance.below(2) == 0 {
                [0; 3]
            } else {
                moves[0]
            };
            moves = [alike; 4];
        }
        Family::Coplanar => {
            for point in at.iter_mut().chain(&mut moves) {
                point[2] = 0;
            }
        }
        Family::Grazing if chance.below(2) == 0 => {
            // Along one of the things' sides.
            let side: Point = std::array::from_fn(|axis| at[3][axis] - at[2][axis]);
            let along = scaled(&side, chance.whole(2));
            moves = [moves[0]; 4];
            moves[0] = std::array::from_fn(|axis| moves[0][axis] + PARTS * along[axis]);
            if kind == Kind::EdgeEdge {
                moves[1] = moves[0];
            }
        }
        Family::Shared => {
            let other = 2 + chance.below(2) as usize;
            at[0] = at[other];
            if chance.below(2) == 0 {
                moves[0] = moves[other];
            }
        }
        Family::Far => {
            for point in at.iter_mut().chain(&mut moves) {
                *point = point.map(|x| x >> 10 << 4);
            }
            at = met_again(at, kind);
        }
        _ => {}
    }
    if family == Family::Coplanar {
        for point in at.iter_mut().chain(&mut moves) {
            *point = aslant(point);
        }
    }
    let mut from: [Point; 4] = std::array::from_fn(|node| {
        std::array::from_fn(|axis| at[node][axis] - moves[node][axis] / PARTS * time)
    });
    if family == Family::Close {
        let node = chance.below(4) as usize;
        let least = SIZE >> (1 + chance.below(20));
        let by = chance.point(least);
        from[node] = std::array::from_fn(|axis| from[node][axis] + by[axis]);
    }
    if family == Family::Far {
        from = from.map(|point| std::array::from_fn(|axis| point[axis] + AWAY[axis]));
    }
    let to = std::array::from_fn(|node| {
        std::array::from_fn(|axis| from[node][axis] + moves[node][axis])
    });
    let meets_at = match family {
        Family::Random | Family::Close => None,
        Family::Resting => Some(0),
        _ => Some(time),
    };
    Drawn {
        query: Query { kind, from, to },
        meets_at,
    }
}

/// Four nodes of two things that share a point.
fn met(chance: &mut Chance, kind: Kind, family: Family) -> [Point; 4] {
    let mut point = || scaled(&chance.point(SIZE / PARTS), PARTS);
    let mut nodes: [Point; 4] = std::array::from_fn(|_| point());
    if family == Family::Degenerate {
        // Two nodes in one place, or three on a line.
        let (one, other) = [(2, 3), (1, 2), (0, 1)][chance.below(3) as usize];
        nodes[one] = nodes[other];
        if chance.below(2) == 0 {
            let (a, b) = (nodes[2], nodes[3]);
            nodes[1] = std::array::from_fn(|axis| 2 * b[axis] - a[axis]);
        }
    }
    let mut place = || match (family, chance.below(2)) {
        (Family::Grazing, 0) => PARTS * i128::from(chance.below(2)),
        _ => i128::from(chance.below(17)),
    };
    let (u, v) = (place(), place());
    meeting_at(nodes, kind, u, v)
}

/// Moves what must be moved for them to share the point at these sixteenths of their sides.
fn meeting_at(mut nodes: [Point; 4], kind: Kind, u: i128, v: i128) -> [Point; 4] {
    match kind {
        Kind::VertexFace => {
            let (u, v) = if u + v > PARTS {
                (PARTS - u, PARTS - v)
            } else {
                (u, v)
            };
            nodes[0] = std::array::from_fn(|axis| {
                let sum =
                    (PARTS - u - v) * nodes[1][axis] + u * nodes[2][axis] + v * nodes[3][axis];
                sum / PARTS
            });
        }
        Kind::EdgeEdge => {
            let by: Point = std::array::from_fn(|axis| {
                let first = (PARTS - u) * nodes[0][axis] + u * nodes[1][axis];
                let second = (PARTS - v) * nodes[2][axis] + v * nodes[3][axis];
                (first - second) / PARTS
            });
            for node in [2, 3] {
                nodes[node] = std::array::from_fn(|axis| nodes[node][axis] + by[axis]);
            }
        }
    }
    nodes
}

/// In the middle, after the nodes have been rounded to multiples of 16.
fn met_again(nodes: [Point; 4], kind: Kind) -> [Point; 4] {
    meeting_at(nodes, kind, 5, 7)
}

fn scaled(point: &Point, by: i128) -> Point {
    point.map(|x| x * by)
}

/// From the plane z = 0 to one that no axis lies in.
fn aslant(point: &Point) -> Point {
    let [x, y, z] = *point;
    [x, y, z + x + 2 * y]
}
