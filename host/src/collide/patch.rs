//! A triangle or parallelogram in space whose corners move on straight lines: all differences between a
//! point and a face, or between two edges, over a step.
//!
//! Entry points: [`Patch::at`], [`Patch::halves`], [`closest`]. Difference zero is where two things meet, so
//! everything asks where the patch passes the origin.

use nalgebra::Vector3;

/// Corners in order around it: 3 of a triangle, 4 of a parallelogram.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch<const N: usize> {
    /// Corners at time 0 \[m\], (N x 3).
    pub start: [Vector3<f64>; N],
    /// Corners at time 1 \[m\], (N x 3).
    pub end: [Vector3<f64>; N],
    /// Place of each corner on the whole patch, which has (0, 0), (1, 0), then (1, 1) if it is a
    /// parallelogram, and (0, 1), (N x 2).
    pub place: [[f64; 2]; N],
}

impl<const N: usize> Patch<N> {
    /// The whole patch.
    pub fn new(start: [Vector3<f64>; N], end: [Vector3<f64>; N]) -> Self {
        let around = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let place =
            std::array::from_fn(|corner| around[corner + usize::from(N == 3 && corner == 2)]);
        Self { start, end, place }
    }

    /// Its corners at a time.
    pub fn at(&self, time: f64) -> [Vector3<f64>; N] {
        std::array::from_fn(|corner| {
            self.start[corner] + (self.end[corner] - self.start[corner]) * time
        })
    }

    /// Where on the whole patch a mixture of the corners is.
    pub fn place_of(&self, weights: &[f64; N]) -> [f64; 2] {
        let along = |axis| {
            let parts = self.place.iter().zip(weights);
            parts
                .map(|(place, weight): (&[f64; 2], _)| place[axis] * weight)
                .sum()
        };
        [along(0), along(1)]
    }

    /// Two halves, cut where it is longest at either end; first the one with more of `weights`. New corners
    /// are means of two old ones: they are off by half a unit in the last place of the largest.
    pub fn halves(&self, weights: &[f64; N]) -> [Self; 2] {
        let next = |corner: usize| (corner + 1) % N;
        let length = |corner: usize| {
            let along = |at: &[Vector3<f64>; N]| (at[next(corner)] - at[corner]).norm_squared();
            along(&self.start).max(along(&self.end))
        };
        // Opposite sides of a parallelogram are equally long.
        let sides = if N == 3 { 3 } else { 2 };
        let cut = (0..sides).fold(0, |longest, side| {
            if length(side) > length(longest) {
                side
            } else {
                longest
            }
        });
        let mut halves = [*self; 2];
        let [near, far] = &mut halves;
        near.move_corner(next(cut), cut, self);
        far.move_corner(cut, next(cut), self);
        let mut more = weights[cut] - weights[next(cut)];
        if N == 4 {
            let (over, next_over) = ((cut + 3) % N, (cut + 2) % N);
            near.move_corner(next_over, over, self);
            far.move_corner(over, next_over, self);
            more += weights[over] - weights[next_over];
        }
        if more < 0.0 {
            halves.swap(0, 1);
        }
        halves
    }

    /// Half-way towards another corner of `whole`.
    fn move_corner(&mut self, corner: usize, towards: usize, whole: &Self) {
        self.start[corner] = 0.5 * (whole.start[corner] + whole.start[towards]);
        self.end[corner] = 0.5 * (whole.end[corner] + whole.end[towards]);
        let (a, b) = (whole.place[corner], whole.place[towards]);
        self.place[corner] = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    }
}

/// The point of a patch that is closest to the origin.
pub(crate) struct Closest<const N: usize> {
    /// Where it is \[m\], (3).
    pub point: Vector3<f64>,
    /// Mixture of the corners that gives it.
    pub weights: [f64; N],
    /// The patch's normal where the point is not on the border, of any length.
    pub normal: Option<Vector3<f64>>,
}

/// Up to round-off, and on the border if the patch has hardly an area: nobody relies on its being exact.
pub(crate) fn closest<const N: usize>(corners: &[Vector3<f64>; N]) -> Closest<N> {
    if let Some(inside) = foot(corners) {
        return inside;
    }
    let mut best = Closest {
        point: corners[0],
        weights: [0.0; N],
        normal: None,
    };
    let mut nearest = f64::INFINITY;
    for corner in 0..N {
        let next = (corner + 1) % N;
        let (from, side) = (corners[corner], corners[next] - corners[corner]);
        // Not a number where the side has no length.
        let along = -from.dot(&side) / side.norm_squared();
        let along = if along > 0.0 { along.min(1.0) } else { 0.0 };
        let point = from + side * along;
        let square = point.norm_squared();
        if square < nearest {
            nearest = square;
            best.point = point;
            best.weights = [0.0; N];
            best.weights[corner] = 1.0 - along;
            best.weights[next] += along;
        }
    }
    best
}

/// The foot of the perpendicular from the origin, if it falls on the patch.
fn foot<const N: usize>(corners: &[Vector3<f64>; N]) -> Option<Closest<N>> {
    let last = N - 1;
    let (from, a, b) = (
        corners[0],
        corners[1] - corners[0],
        corners[last] - corners[0],
    );
    let normal = a.cross(&b);
    let area = normal.norm_squared();
    // Sides at less than a microradian: where on them the foot is gets lost in round-off, and some point of the
    // border is as near but for a millionth of the patch's size.
    if area <= 1e-12 * a.norm_squared() * b.norm_squared() {
        return None;
    }
    let u = b.cross(&from).dot(&normal) / area;
    let v = from.cross(&a).dot(&normal) / area;
    let inside = u >= 0.0
        && v >= 0.0
        && if N == 3 {
            u + v <= 1.0
        } else {
            u.max(v) <= 1.0
        };
    if !inside {
        return None;
    }
    let mut weights = [0.0; N];
    if N == 3 {
        (weights[0], weights[1], weights[last]) = (1.0 - u - v, u, v);
    } else {
        (weights[0], weights[1]) = ((1.0 - u) * (1.0 - v), u * (1.0 - v));
        (weights[2], weights[last]) = (u * v, (1.0 - u) * v);
    }
    Some(Closest {
        // Of the same weights, even if they are not exact.
        point: from + a * u + b * v,
        weights,
        normal: Some(normal),
    })
}
