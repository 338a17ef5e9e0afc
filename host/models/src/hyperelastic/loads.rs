//! Loads that belong to shape functions: tractions on faces, forces in the volume.
//!
//! Entry points: [`traction`], [`body_force`]. Both do the same work on every displacement that the cells can
//! have as the distributed load does.

use super::discrete::{Discrete, EDGES};
use nalgebra::Vector3;

/// A rule of degree five with 14 points (Walkington 2000): weight, and barycentric coordinates that are
/// equal. Three or two of them; the rest follows.
const CORNERS: [(f64, f64); 2] = [
    (0.112_687_925_718_015_85, 0.310_885_919_263_300_6),
    (0.073_493_043_116_361_95, 0.092_735_250_310_891_23),
];
const MIDDLES: (f64, f64) = (0.042_546_020_777_081_47, 0.045_503_704_125_649_65);

/// Points of the rule: weight, barycentric coordinates.
pub(super) fn rule() -> impl Iterator<Item = (f64, [f64; 4])> {
    let corners = CORNERS.into_iter().flat_map(|(weight, few)| {
        (0..4).map(move |corner| {
            let many = 1.0 - 3.0 * few;
            (
                weight,
                std::array::from_fn(|c| if c == corner { many } else { few }),
            )
        })
    });
    let (weight, few) = MIDDLES;
    let middles = EDGES.into_iter().map(move |(a, b)| {
        let many = 0.5 - few;
        let at = std::array::from_fn(|c| if c == a || c == b { many } else { few });
        (weight, at)
    });
    corners.chain(middles)
}

/// Adds a force \[N\], spread evenly over `faces`, to the nodes' loads: a third to each corner of a linear
/// face, a third to each mid-edge node of a quadratic one. `Err`: the first face that is none of the
/// boundary's.
pub(super) fn traction(
    discrete: &Discrete,
    faces: &[[u32; 3]],
    force: Vector3<f64>,
    load: &mut [Vector3<f64>],
) -> Result<(), usize> {
    let area = |face: &[u32; 3]| {
        let p = face.map(|node| discrete.rest[node as usize]);
        0.5 * (p[1] - p[0]).cross(&(p[2] - p[0])).norm()
    };
    let sound = |face: &[u32; 3]| face.iter().all(|node| (*node as usize) < discrete.corners);
    if let Some(wrong) = faces.iter().position(|face| !sound(face)) {
        return Err(wrong);
    }
    let total: f64 = faces.iter().map(area).sum();
    for (index, face) in faces.iter().enumerate() {
        let share = force * (area(face) / total / 3.0);
        let [a, b, c] = *face;
        if discrete.per_cell == 4 {
            for node in [a, b, c] {
                load[node as usize] += share;
            }
            continue;
        }
        for (a, b) in [(a, b), (b, c), (c, a)] {
            let ends = [a.min(b), a.max(b)];
            let node = discrete.ends.binary_search(&ends).map_err(|_| index)?;
            load[discrete.corners + node] += share;
        }
    }
    Ok(())
}

/// Adds a force per volume at rest \[N/m^3\], given at rest positions \[m\], to the nodes' loads.
pub(super) fn body_force(
    discrete: &Discrete,
    density: impl Fn([f64; 3]) -> [f64; 3],
    load: &mut [Vector3<f64>],
) {
    for cell in 0..discrete.volume.len() {
        let nodes = discrete.cell_nodes(cell);
        for (weight, at) in rule() {
            let (values, _) = discrete.shape(cell, at);
            let point: Vector3<f64> = (0..4)
                .map(|corner| at[corner] * discrete.rest[nodes[corner] as usize])
                .sum();
            let force = Vector3::from(density(point.into())) * (weight * discrete.volume[cell]);
            for (&node, value) in nodes.iter().zip(values) {
                load[node as usize] += value * force;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Barycentric monomials have known integrals: 6 a! b! c! d! / (3 + a + b + c + d)! of the volume.
    #[test]
    fn the_rule_is_exact_to_degree_five() {
        let factorial = |n: u32| (1..=n).product::<u32>() as f64;
        for degree in 0..=5u32 {
            for a in 0..=degree {
                for b in 0..=degree - a {
                    for c in 0..=degree - a - b {
                        let powers = [a, b, c, degree - a - b - c];
                        let exact = 6.0 * powers.map(factorial).iter().product::<f64>()
                            / factorial(3 + degree);
                        let found: f64 = rule()
                            .map(|(weight, at)| {
                                let terms = at.iter().zip(powers);
                                weight * terms.map(|(x, p)| x.powi(p as i32)).product::<f64>()
                            })
                            .sum();
                        assert!((found - exact).abs() < 1e-14, "{powers:?}: {found} {exact}");
                    }
                }
            }
        }
    }
}
