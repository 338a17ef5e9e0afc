//! How far a point is from tissue, on which side, and the way out.
//!
//! Entry point: [`Skin::distance`]. The side is that of the angle-weighted normal of the nearest face, edge or vertex
//! (Baerentzen & Aanaes 2005), which is right for any closed surface; the nearest point is Ericson's (2004, 5.1.5).

use super::skin::{Side, Skin};
use crate::boxes::Bounds;
use nalgebra::Vector3;

/// Faces around a vertex at most.
const MOST_AROUND: usize = 64;

/// What the nearest point of a face lies on, by corners.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Feature {
    Face,
    /// From this corner to the next.
    Edge(u32),
    Vertex(u32),
}

impl Skin {
    /// Distance of a point from the surface \[m\], negative inside, and the unit way out there, if it is below
    /// `below`; inside no deeper than [`Skin::reach_m`]. Nodes are at `at` \[m\]. Allocates nothing.
    pub fn distance(
        &self,
        at: &[Vector3<f64>],
        point: &Vector3<f64>,
        below: f64,
    ) -> Option<(f64, Vector3<f64>)> {
        let reach = self.reach_m().max(below);
        let mut nearest: Option<(f64, u32, Feature, Vector3<f64>)> = None;
        self.near(&Bounds::NOTHING.with(point).grown(reach), |face| {
            let Some(corners) = self.corners(at, face) else {
                return;
            };
            let (feature, there) = nearest_on(point, &corners);
            let far = (point - there).norm_squared();
            if nearest.is_none_or(|(least, ..)| far < least) {
                nearest = Some((far, face, feature, there));
            }
        });
        let (far, face, feature, there) = nearest.filter(|(far, ..)| *far <= reach * reach)?;
        let out = self.normal(at, face, feature)?;
        let (away, far) = (point - there, far.sqrt());
        let inside = away.dot(&out) < 0.0;
        let distance = if inside { -far } else { far };
        let out = match away.try_normalize(1e-12 * reach) {
            Some(away) if inside => -away,
            Some(away) => away,
            None => out,
        };
        (distance < below).then_some((distance, out))
    }

    fn corners(&self, at: &[Vector3<f64>], face: u32) -> Option<[Vector3<f64>; 3]> {
        let [a, b, c] = self.face(face).map(|node| at.get(node as usize).copied());
        Some([a?, b?, c?])
    }

    /// Angle-weighted outward unit normal of a feature of a face.
    fn normal(&self, at: &[Vector3<f64>], face: u32, feature: Feature) -> Option<Vector3<f64>> {
        let of_face = |face: u32| {
            let [a, b, c] = self.corners(at, face)?;
            (b - a).cross(&(c - a)).try_normalize(0.0)
        };
        let sum = match feature {
            Feature::Face => of_face(face)?,
            Feature::Edge(corner) => {
                let beyond = self.across(Side { face, corner });
                let other = beyond.and_then(|side| of_face(side.face));
                of_face(face)? + other.unwrap_or_else(Vector3::zeros)
            }
            Feature::Vertex(corner) => {
                let first = Side { face, corner };
                let (mut side, mut sum) = (first, Vector3::zeros());
                for _ in 0..MOST_AROUND {
                    let corners = self.corners(at, side.face)?;
                    let k = side.corner as usize;
                    let (a, b) = (
                        corners[(k + 1) % 3] - corners[k],
                        corners[(k + 2) % 3] - corners[k],
                    );
                    if let Some(normal) = a.cross(&b).try_normalize(0.0) {
                        sum += normal * a.angle(&b);
                    }
                    // The side that ends in the vertex leaves it in the face beyond.
                    let last = Side {
                        face: side.face,
                        corner: (side.corner + 2) % 3,
                    };
                    match self.across(last) {
                        Some(next) if next != first => side = next,
                        _ => break,
                    }
                }
                sum
            }
        };
        sum.try_normalize(0.0)
    }
}

/// The point of a triangle that is nearest to `p`, and what it lies on.
fn nearest_on(p: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> (Feature, Vector3<f64>) {
    let (ab, ac) = (b - a, c - a);
    let ap = p - a;
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (Feature::Vertex(0), *a);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (Feature::Vertex(1), *b);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (Feature::Edge(0), a + ab * (d1 / (d1 - d3)));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (Feature::Vertex(2), *c);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (Feature::Edge(2), a + ac * (d2 / (d2 - d6)));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return (Feature::Edge(1), b + (c - b) * share);
    }
    let sum = va + vb + vc;
    (Feature::Face, a + ab * (vb / sum) + ac * (vc / sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{slab, tube};

    /// Against solid angles for the side, and points all over the surface for the distance.
    #[test]
    fn side_and_distance_are_right_all_around() {
        let block = slab([0.02, 0.02, 0.01], [3, 3, 2]).expect("a block");
        let ring = tube([0.006, 0.011], [0.0, 0.012], [2, 11, 3]).expect("a tube");
        for mesh in [block, ring] {
            let surface = mesh.surface();
            // With dents and horns, so that edges and vertices of either kind are nearest.
            let at: Vec<Vector3<f64>> = (0..)
                .zip(mesh.points_m())
                .map(|(node, p)| {
                    let noise = |k: i32| 4e-4 * f64::from(7 * node + k).sin();
                    Vector3::from(*p) + Vector3::new(noise(1), noise(2), noise(3))
                })
                .collect();
            let points_m: Vec<[f64; 3]> = at.iter().map(|p| (*p).into()).collect();
            let skin = Skin::new(&surface.triangles, &at);
            let mut dense = Vec::new();
            for face in &surface.triangles {
                let [a, b, c] = face.map(|node| at[node as usize]);
                for i in 0..=20 {
                    for j in 0..=20 - i {
                        let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                        dense.push(a + (b - a) * u + (c - a) * v);
                    }
                }
            }
            let (mut insides, mut founds) = (0, 0);
            for k in 0..3000 {
                let x = |n: f64| (0.5 * f64::from(k) * n).sin();
                let point = Vector3::new(0.012 * x(1.1), 0.012 * x(1.7), 0.0015 + 0.0125 * x(2.3));
                let inside = surface.contains(&points_m, point.into());
                let far = dense
                    .iter()
                    .map(|p| p.metric_distance(&point))
                    .fold(f64::MAX, f64::min);
                let found = skin.distance(&at, &point, 5e-4);
                let signed = if inside { -far } else { far };
                match found {
                    None => assert!(
                        signed > 4.9e-4 || signed < -0.99 * skin.reach_m(),
                        "{signed}"
                    ),
                    Some((distance, out)) => {
                        // Samples are up to 0.3 mm from the nearest point.
                        assert_eq!(distance < 0.0, inside, "{distance} {signed}");
                        let least = (far * far - 9e-8).max(0.0).sqrt();
                        assert!(
                            (least..=far).contains(&distance.abs()),
                            "{distance} {signed}"
                        );
                        assert!((out.norm() - 1.0).abs() < 1e-12);
                        // The way out leads there.
                        let next = skin.distance(&at, &(point - out * (distance - 1e-6)), 1.0);
                        assert!(
                            next.is_some_and(|(d, _)| (d - 1e-6).abs() < 1e-7),
                            "{next:?} from {found:?}"
                        );
                        founds += 1;
                        insides += u32::from(inside);
                    }
                }
            }
            assert!(
                insides > 100 && founds - insides > 50,
                "{insides} of {founds}"
            );
        }
    }
}
