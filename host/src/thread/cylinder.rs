//! The shortest line over a cylinder, between two points outside of it.
//!
//! Entry point: [`Cylinder::around`]. Two straight pieces and a helix between them: unrolled it is one straight line (Garner &
//! Pandy 2000, single cylinder). The cylinder goes on beyond its ends here; whoever asks looks where on it the line lies.

use nalgebra::Vector3;
use serde::Serialize;
use std::f64::consts::TAU;

/// Largest turn between two points that are drawn of a helix \[rad\].
const DRAWN_TURN: f64 = 0.25;

/// A cylinder without ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Cylinder {
    /// A point of its axis \[m\], and a unit vector along that, (3) each.
    pub origin: Vector3<f64>,
    pub axis: Vector3<f64>,
    pub radius_m: f64,
}

/// The shortest line; of pairs the first is of the piece that comes to the cylinder, the second of the one that leaves it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Around {
    /// Where it comes to the cylinder and leaves it \[m\].
    pub on: [Vector3<f64>; 2],
    /// Unit vectors along the straight pieces.
    pub along: [Vector3<f64>; 2],
    /// Unit vectors across them: away from the cylinder, and in its tangent plane. The length's second derivative is
    /// `e e' / straight_m` for each of the former, and `(n_2 - n_1)(n_2 - n_1)' / length` for the latter together: along the
    /// axis the line gives way as a whole.
    pub across: [[Vector3<f64>; 2]; 2],
    /// Lengths of the straight pieces, and of the helix \[m\].
    pub straight_m: [f64; 2],
    pub arc_m: f64,
    /// By which it turns about the axis \[rad\]; below zero where the line that is bent so is free of the cylinder.
    pub turn: f64,
    /// Middle of the helix along the axis, from the origin \[m\].
    pub middle_m: f64,
}

impl Cylinder {
    /// The shortest line that leads from `from` to `to` \[m\] counterclockwise about the axis, if `side` is 1, or clockwise, if it is
    /// -1, and turns by about `near` \[rad\]: give or take half a turn. A point inside the cylinder counts as on it.
    pub fn around(&self, from: &Vector3<f64>, to: &Vector3<f64>, side: f64, near: f64) -> Around {
        let (x, y) = super::segments::across(&self.axis);
        let polar = |at: &Vector3<f64>| {
            let way = at - self.origin;
            let (a, b) = (way.dot(&x), way.dot(&y));
            (a.hypot(b), b.atan2(a), way.dot(&self.axis))
        };
        let ends = [polar(from), polar(to)];
        let flat_m = ends.map(|(far, ..)| {
            let square = far * far - self.radius_m * self.radius_m;
            square.max(0.0).sqrt()
        });
        let lead = ends.map(|(far, ..)| (self.radius_m / far).min(1.0).acos());
        let angles = [ends[0].1 + side * lead[0], ends[1].1 - side * lead[1]];
        let turn = side * (angles[1] - angles[0]);
        let turn = turn + TAU * ((near - turn) / TAU).round();
        let planar_m = flat_m[0] + self.radius_m * turn + flat_m[1];
        let rise_m = ends[1].2 - ends[0].2;
        let length_m = planar_m.hypot(rise_m);
        let (cos, sin) = (planar_m / length_m, rise_m / length_m);
        let slope = rise_m / planar_m;
        let heights = [ends[0].2 + slope * flat_m[0], ends[1].2 - slope * flat_m[1]];
        let out = angles.map(|angle| x * angle.cos() + y * angle.sin());
        let ahead = out.map(|out| self.axis.cross(&out) * side);
        let on =
            [0, 1].map(|end| self.origin + out[end] * self.radius_m + self.axis * heights[end]);
        Around {
            on,
            along: ahead.map(|ahead| ahead * cos + self.axis * sin),
            across: [0, 1].map(|end| [out[end], self.axis * cos - ahead[end] * sin]),
            straight_m: flat_m.map(|flat_m| flat_m / cos),
            arc_m: self.radius_m * turn / cos,
            turn,
            middle_m: 0.5 * (heights[0] + heights[1]),
        }
    }

    /// Points to draw of the helix of a line on a `side` of it \[m\], from where it comes to the cylinder to where it leaves it.
    pub fn drawn(&self, around: &Around, side: f64) -> impl Iterator<Item = Vector3<f64>> + use<> {
        let Self { origin, axis, .. } = *self;
        let Around { on, turn, .. } = *around;
        let count = (turn / DRAWN_TURN).ceil().max(1.0) as u32;
        let first = on[0] - origin;
        let (height_m, rise_m) = (first.dot(&axis), (on[1] - on[0]).dot(&axis));
        let out = first - axis * height_m;
        let way = axis.cross(&out) * side;
        (0..=count).map(move |place| {
            let part = f64::from(place) / f64::from(count);
            let (sin, cos) = (part * turn).sin_cos();
            origin + out * cos + way * sin + axis * (height_m + part * rise_m)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    fn length_m(around: &Around) -> f64 {
        around.straight_m[0] + around.arc_m + around.straight_m[1]
    }

    /// Cylinders that lie in all directions, with two points, the side and the turn.
    fn cases() -> Vec<(Cylinder, Vector3<f64>, Vector3<f64>, f64)> {
        let mut random = fastrand::Rng::with_seed(7);
        let mut number = || 2.0 * random.f64() - 1.0;
        let mut cases = Vec::new();
        while cases.len() < 200 {
            let mut vector = || Vector3::new(number(), number(), number());
            let (origin, axis, from, to) = (vector(), vector().normalize(), vector(), vector());
            let side = if number() > 0.0 { 1.0 } else { -1.0 };
            let cylinder = Cylinder {
                origin,
                axis,
                radius_m: 0.3 + 0.2 * number(),
            };
            let far = |at: Vector3<f64>| (at - origin).cross(&axis).norm();
            let around = cylinder.around(&from, &to, side, 1.0);
            let is_off = far(from).min(far(to)) > 1.1 * cylinder.radius_m;
            if is_off && around.turn > 0.1 && (around.turn - 1.0).abs() < 3.0 {
                cases.push((cylinder, from, to, side));
            }
        }
        cases
    }

    /// Ends are led to tangentially, the pieces are as long as they say, and no line over points of the cylinder beside is shorter.
    #[test]
    fn it_is_the_shortest_line() {
        for (cylinder, from, to, side) in cases() {
            let around = cylinder.around(&from, &to, side, 1.0);
            let Cylinder {
                origin,
                axis,
                radius_m,
            } = cylinder;
            let legs = [around.on[0] - from, to - around.on[1]];
            for (end, leg) in legs.iter().enumerate() {
                let off = leg - around.along[end] * around.straight_m[end];
                assert!(off.norm() < 1e-12, "{off}");
                let out = (around.on[end] - origin) - axis * axis.dot(&(around.on[end] - origin));
                assert!((out.norm() - radius_m).abs() < 1e-12);
                assert!(out.dot(&around.along[end]).abs() < 1e-12);
                let [e, n] = around.across[end];
                assert!((e.cross(&n).dot(&around.along[end]).abs() - 1.0).abs() < 1e-12);
            }
            let length = |moves: [f64; 4]| {
                let [turned, up, turned_2, up_2] = moves;
                let place = |on: Vector3<f64>, turned: f64, up: f64| {
                    let turn = nalgebra::UnitQuaternion::from_scaled_axis(axis * (side * turned));
                    origin + turn * (on - origin) + axis * up
                };
                let on = [
                    place(around.on[0], turned, up),
                    place(around.on[1], turned_2, up_2),
                ];
                let rise = (on[1] - on[0]).dot(&axis);
                let arc = (radius_m * (around.turn + turned_2 - turned)).hypot(rise);
                (on[0] - from).norm() + arc + (to - on[1]).norm()
            };
            let least = length_m(&around);
            assert!((length([0.0; 4]) - least).abs() < 1e-12);
            // Turned the other way a straight piece would lead through the cylinder.
            for (place, by) in [
                (0, -1e-3),
                (1, -1e-3),
                (1, 1e-3),
                (2, 1e-3),
                (3, -1e-3),
                (3, 1e-3),
            ] {
                let mut moves = [0.0; 4];
                moves[place] = by;
                assert!(length(moves) > least, "{place} {by}");
            }
        }
    }

    /// The first and second derivative of the length are those of the line's directions.
    #[test]
    fn its_directions_are_its_derivatives() {
        for (cylinder, from, to, side) in cases() {
            let around = cylinder.around(&from, &to, side, 1.0);
            let at = |by: Vector6<f64>| {
                let part = |first| Vector3::new(by[first], by[first + 1], by[first + 2]);
                cylinder.around(&(from + part(0)), &(to + part(3)), side, around.turn)
            };
            let slope = |around: &Around| {
                let [a, b] = around.along;
                Vector6::new(-a.x, -a.y, -a.z, b.x, b.y, b.z)
            };
            let ends =
                |a: Vector3<f64>, b: Vector3<f64>| Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z);
            let none = Vector3::zeros();
            let [[e, n], [e_2, n_2]] = around.across;
            let stiff = [
                (ends(e, none), around.straight_m[0]),
                (ends(none, e_2), around.straight_m[1]),
                (ends(-n, n_2), length_m(&around)),
            ];
            let h = 1e-6;
            for axis in 0..6 {
                let [ahead, behind] = [h, -h].map(|by| at(Vector6::ith(axis, by)));
                let found = (length_m(&ahead) - length_m(&behind)) / (2.0 * h);
                assert!((found - slope(&around)[axis]).abs() < 1e-8);
                let found = (slope(&ahead) - slope(&behind)) / (2.0 * h);
                let said: Vector6<f64> = stiff
                    .iter()
                    .map(|(row, length_m)| row * (row[axis] / length_m))
                    .sum();
                assert!(
                    (found - said).norm() < 1e-6 * (1.0 + said.norm()),
                    "{found} {said}"
                );
            }
        }
    }

    /// What is drawn lies on the cylinder, from one end of the helix to the other, and is as long.
    #[test]
    fn the_helix_is_drawn() {
        for (cylinder, from, to, side) in cases() {
            let around = cylinder.around(&from, &to, side, 1.0);
            let points: Vec<_> = cylinder.drawn(&around, side).collect();
            assert!((points[0] - around.on[0]).norm() < 1e-12);
            assert!((points[points.len() - 1] - around.on[1]).norm() < 1e-12);
            let long_m: f64 = points.windows(2).map(|two| (two[1] - two[0]).norm()).sum();
            let off = long_m / around.arc_m - 1.0;
            assert!((-0.003..=1e-12).contains(&off), "{off}");
            for point in points {
                let far = (point - cylinder.origin).cross(&cylinder.axis).norm();
                assert!((far - cylinder.radius_m).abs() < 1e-12);
            }
        }
    }

    /// Around and around: a turn more is a turn of the cylinder longer.
    #[test]
    fn a_turn_more_is_kept() {
        let (cylinder, from, to, side) = cases()[0];
        let once = cylinder.around(&from, &to, side, 1.0);
        let twice = cylinder.around(&from, &to, side, 1.0 + TAU);
        assert!((twice.turn - once.turn - TAU).abs() < 1e-12);
    }
}
