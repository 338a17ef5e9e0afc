//! Whether two things meet, by bisection in exact arithmetic.
//!
//! Entry point: [`Query::decide`]. Coordinates are whole numbers of a unit, so that the corners of
//! halves are whole numbers of half a unit: rational arithmetic without a denominator. The difference of the
//! two things is linear in time and in each of the two places, its Bernstein coefficients on a box are
//! its corners' values, and a box where those along one direction have one sign is free. Directions are the
//! axes and, so that it does not take for ever where things pass close by, whole numbers near the box's normal. A box that is as small as
//! 2^-40 in time and both places and not free counts as a hit.

use nalgebra::Vector3;

/// A position in units, (3).
pub type Point = [i128; 3];

/// Largest coordinate \[units\]: boxes that are not free then keep their corners below 2^127.
pub const LARGEST: i128 = 1 << 30;
/// Halvings in each direction.
const DEPTH: u32 = 40;
/// Largest part of a direction.
const WHOLE: i32 = 1 << 9;
/// Boxes after which no answer is given: of things that come near for long before they meet.
const MOST_BOXES: u32 = 1_000_000;

/// Two things that move on straight lines over a step: four nodes from their start to their end.
#[derive(Clone, Copy, Debug)]
pub struct Query {
    pub kind: Kind,
    pub from: [Point; 4],
    pub to: [Point; 4],
}

/// Which two things the four nodes are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The first, and the face of the others.
    VertexFace,
    /// The first two, and the last two.
    EdgeEdge,
}

/// What exact bisection found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exact {
    /// They do not meet.
    Apart,
    /// A box of 2^-40 is not free; when it begins, in 2^-40 of the step.
    Hit(i128),
    /// Too many boxes.
    TooLong,
}

/// One box: corners by time, first place and second place, in units that are halved with every halving.
#[derive(Clone, Copy)]
struct Box {
    corners: [[i128; 3]; 8],
    /// Its lowest time and places, in its own size.
    low: [i128; 3],
    depth: [u32; 3],
}

impl Query {
    /// The part of the motion up to so many sixteenths of the step, in sixteenths of a unit.
    pub fn until(&self, sixteenths: i128) -> Self {
        let mut part = *self;
        for (from, to) in part.from.iter_mut().zip(&mut part.to) {
            for (from, to) in from.iter_mut().zip(to) {
                *to = (16 - sixteenths) * *from + sixteenths * *to;
                *from *= 16;
            }
        }
        part
    }

    /// Bisects.
    pub fn decide(&self) -> Exact {
        let mut waiting = vec![self.whole()];
        let mut boxes = 0;
        while let Some(part) = waiting.pop() {
            boxes += 1;
            if boxes > MOST_BOXES {
                return Exact::TooLong;
            }
            if self.is_outside(&part) || part.is_free() {
                continue;
            }
            // In turn, so that the corners do not outgrow their type.
            let [time, first, second] = part.depth;
            if second == DEPTH {
                return Exact::Hit(part.low[0]);
            }
            let axis = if time == second {
                0
            } else if first == second {
                1
            } else {
                2
            };
            let [low, high] = part.halves(axis);
            waiting.extend([high, low]);
        }
        Exact::Apart
    }

    fn whole(&self) -> Box {
        let corner = |index: usize| -> Point {
            let at = if index & 4 == 0 { &self.from } else { &self.to };
            let (u, v) = ((index >> 1 & 1) as i128, (index & 1) as i128);
            let weights = match self.kind {
                Kind::VertexFace => [1, u + v - 1, -u, -v],
                Kind::EdgeEdge => [1 - u, u, v - 1, -v],
            };
            std::array::from_fn(|axis| (0..4).map(|node| weights[node] * at[node][axis]).sum())
        };
        Box {
            corners: std::array::from_fn(corner),
            low: [0; 3],
            depth: [0; 3],
        }
    }

    /// Whether a box lies on the far side of the square of which the face is one half.
    fn is_outside(&self, part: &Box) -> bool {
        let [_, u, v] = part.low;
        let [_, first, second] = part.depth;
        let common = first.max(second);
        let (u, v) = (u << (common - first), v << (common - second));
        self.kind == Kind::VertexFace && u + v > 1 << common
    }
}

impl Box {
    fn is_free(&self) -> bool {
        (0..3).any(|axis| {
            let mut values = self.corners.iter().map(|corner| corner[axis]);
            values.clone().all(|value| value > 0) || values.all(|value| value < 0)
        }) || self.normals().iter().any(|normal| {
            // Exact, whatever the direction; one that would not fit is not tried.
            let mut sides = [false; 2];
            for corner in &self.corners {
                let along = (0..3).try_fold(0i128, |sum, axis| {
                    sum.checked_add(corner[axis].checked_mul(normal[axis])?)
                });
                match along.map(i128::signum) {
                    Some(1) => sides[1] = true,
                    Some(-1) => sides[0] = true,
                    _ => return false,
                }
            }
            sides[0] != sides[1]
        })
    }

    /// Roughly across both places; and from the middle to the origin, across the first.
    fn normals(&self) -> [[i128; 3]; 2] {
        let place = |index: usize| Vector3::from(self.corners[index].map(|x| x as f64));
        let mean = |bit: usize, value: usize| -> Vector3<f64> {
            let of = (0..8).filter(|index| index & bit == value);
            of.map(place).sum::<Vector3<f64>>() / 4.0
        };
        let (first, second) = (mean(2, 2) - mean(2, 0), mean(1, 1) - mean(1, 0));
        let middle = 0.5 * (mean(4, 0) + mean(4, 4));
        let aside = |along: &Vector3<f64>| {
            let part = middle.dot(along) / along.norm_squared();
            middle - along * if part.is_finite() { part } else { 0.0 }
        };
        let longer = if first.norm() > second.norm() {
            first
        } else {
            second
        };
        [first.cross(&second), aside(&longer)].map(|normal| {
            let scale = f64::from(WHOLE) / normal.amax();
            let scaled = normal * if scale.is_finite() { scale } else { 0.0 };
            scaled.map(|x| x.round() as i128).into()
        })
    }

    fn halves(&self, axis: usize) -> [Self; 2] {
        let bit = 4 >> axis;
        let doubled = |value: i128| value.checked_mul(2).expect("within the type");
        let mut halves = [*self; 2];
        for (side, half) in halves.iter_mut().enumerate() {
            half.low[axis] = 2 * self.low[axis] + side as i128;
            half.depth[axis] += 1;
            for index in 0..8 {
                let (low, high) = (self.corners[index & !bit], self.corners[index | bit]);
                let is_middle = (index & bit != 0) != (side == 1);
                half.corners[index] = std::array::from_fn(|i| {
                    if is_middle {
                        low[i].checked_add(high[i]).expect("within the type")
                    } else {
                        doubled(self.corners[index][i])
                    }
                });
            }
        }
        halves
    }
}

/// The oracle itself, on cases that can be done in the head.
#[test]
fn a_vertex_that_falls_through_a_face_hits_it_half_way() {
    let face = [[0, 0, 0], [8, 0, 0], [0, 8, 0]];
    let with = |from: Point, to: Point| Query {
        kind: Kind::VertexFace,
        from: [from, face[0], face[1], face[2]],
        to: [to, face[0], face[1], face[2]],
    };
    let Exact::Hit(time) = with([1, 1, 3], [1, 1, -3]).decide() else {
        panic!("missed");
    };
    assert!(((1 << 39) - time).abs() <= 1, "{time}");
    // Along the face's longest side, touching it; beyond it by a unit; short of it at the end.
    assert!(matches!(
        with([4, 4, 3], [4, 4, -3]).decide(),
        Exact::Hit(_)
    ));
    assert_eq!(with([5, 4, 3], [5, 4, -3]).decide(), Exact::Apart);
    assert_eq!(with([1, 1, 3], [1, 1, 1]).decide(), Exact::Apart);
    assert!(matches!(with([1, 1, 3], [1, 1, 0]).decide(), Exact::Hit(_)));
    let edges = |height: i128| Query {
        kind: Kind::EdgeEdge,
        from: [[-2, 0, height], [2, 0, height], [0, -2, 0], [0, 2, 0]],
        to: [[-2, 0, -1], [2, 0, -1], [0, -2, 0], [0, 2, 0]],
    };
    assert_eq!(edges(-2).decide(), Exact::Apart);
    let Exact::Hit(time) = edges(3).decide() else {
        panic!("missed");
    };
    assert!((3 * (1 << 38) - time).abs() <= 1, "{time}");
}
