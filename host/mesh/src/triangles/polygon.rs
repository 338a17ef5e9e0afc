//! Polygons into triangles.
//!
//! Entry point: [`split`]. Ears are cut off (Meisters 1975), across the polygon's mean normal (Newell's).

use nalgebra::Vector3;

/// Triangles of a polygon by its corners, which may be concave and a little bent. One that crosses itself comes as a fan.
pub(super) fn split(points_m: &[[f64; 3]], corners: &[u32]) -> Vec<[u32; 3]> {
    let at = |point: u32| {
        let at = points_m.get(point as usize);
        Vector3::from(at.copied().unwrap_or([f64::NAN; 3]))
    };
    let mut left = corners.to_vec();
    let origin = corners
        .first()
        .map_or_else(Vector3::zeros, |first| at(*first));
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let normal: Vector3<f64> = sides
        .map(|(from, to)| (at(*from) - origin).cross(&(at(*to) - origin)))
        .sum();
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
            let inside =
                |p: &u32| side(a, b, *p) >= 0.0 && side(b, c, *p) >= 0.0 && side(c, a, *p) >= 0.0;
            let mut others = left.iter().filter(|p| ![a, b, c].contains(p));
            side(a, b, c) > 0.0 && !others.any(inside)
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
