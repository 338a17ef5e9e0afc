//! Polygons into triangles.
//!
//! Entry point: [`split`]. Ears are cut off (Meisters 1975), across the polygon's mean normal (Newell's).

use super::check::ROUNDING;
use nalgebra::Vector3;

/// Triangles of a polygon by its corners, which may be concave and a little bent. One that crosses itself comes as a fan.
pub(super) fn split(points_m: &[[f64; 3]], corners: &[u32]) -> Vec<[u32; 3]> {
    let at = |point: u32| place(points_m, point);
    let mut left = corners.to_vec();
    let normal = normal(points_m, corners);
    // Corners on a straight line make no ear, and lie on an ear's side as well as inside.
    let rounding = ROUNDING * normal.norm_squared();
    let mut triangles = Vec::new();
    while left.len() > 3 {
        let count = left.len();
        let ear = |k: usize| {
            [
                left[(k + count - 1) % count],
                left[k],
                left[(k + 1) % count],
            ]
        };
        let side = |a: u32, b: u32, c: u32| (at(b) - at(a)).cross(&(at(c) - at(a))).dot(&normal);
        let is_ear = |k: &usize| {
            let [a, b, c] = ear(*k);
            let inside = |p: &u32| {
                [side(a, b, *p), side(b, c, *p), side(c, a, *p)]
                    .iter()
                    .all(|side| *side >= -rounding)
            };
            let mut others = left.iter().filter(|p| ![a, b, c].contains(p));
            side(a, b, c) > rounding && !others.any(inside)
        };
        let place = (0..count)
            .map(|k| (k + 1) % count)
            .find(is_ear)
            .unwrap_or(1);
        triangles.push(ear(place));
        left.remove(place);
    }
    if let [a, b, c] = left[..] {
        triangles.push([a, b, c]);
    }
    triangles
}

/// Twice the area of a polygon, along its mean normal \[m^2\] (Newell's).
pub(super) fn normal(points_m: &[[f64; 3]], corners: &[u32]) -> Vector3<f64> {
    let Some(first) = corners.first() else {
        return Vector3::zeros();
    };
    let origin = place(points_m, *first);
    let at = |point: &u32| place(points_m, *point) - origin;
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    sides.map(|(from, to)| at(from).cross(&at(to))).sum()
}

/// Not a number for a point that does not exist.
fn place(points_m: &[[f64; 3]], point: u32) -> Vector3<f64> {
    let at = points_m.get(point as usize);
    Vector3::from(at.copied().unwrap_or([f64::NAN; 3]))
}
