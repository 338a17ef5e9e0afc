//! Goals of all clusters where nodes are: the pull towards them and its energy.
//!
//! Entry point: [`pull`]. After qian-2015, (1), (2) and lines 7 to 23 of its algorithm; (1) is taken as the outer
//! product it has to be. Centre and rotation are optimal, so the pull is the exact gradient of the energy.

use super::clusters::Clusters;
use super::rotation::best_rotation;
use nalgebra::{Matrix3, Vector3};

/// Writes the pull of the goals on every node at `x` \[N\] and returns the energy \[J\]:
/// f_i = sum_c w_ci (g_ci - x_i), E = sum_c sum_i w_ci |g_ci - x_i|^2 / 2. `None` where positions are not finite.
pub(super) fn pull(clusters: &Clusters, x: &[[f64; 3]], force: &mut [[f64; 3]]) -> Option<f64> {
    force.fill([0.0; 3]);
    let mut energy_j = 0.0;
    for cluster in clusters.iter() {
        let (mut weight, mut first) = (0.0, Vector3::zeros());
        // From the first node, so that a far body loses no digits.
        let near = Vector3::from(x[cluster.first()?.node as usize]);
        for member in cluster {
            weight += member.weight;
            first += member.weight * (Vector3::from(x[member.node as usize]) - near);
        }
        let centre = near + first / weight;
        let mut a = Matrix3::zeros();
        for member in cluster {
            let at = Vector3::from(x[member.node as usize]) - centre;
            a += member.weight * at * Vector3::from(member.rest_m).transpose();
        }
        let turn = best_rotation(&a)?;
        for member in cluster {
            let at = Vector3::from(x[member.node as usize]) - centre;
            let way = turn * Vector3::from(member.rest_m) - at;
            energy_j += 0.5 * member.weight * way.norm_squared();
            let own = &mut force[member.node as usize];
            for axis in 0..3 {
                own[axis] += member.weight * way[axis];
            }
        }
    }
    energy_j.is_finite().then_some(energy_j)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use proptest::prelude::*;
    use sutura_mesh::{TetMesh, slab};

    fn body() -> (TetMesh, Clusters) {
        let mesh = slab([0.03, 0.02, 0.02], [4, 3, 3]).expect("a slab");
        let fat = Material {
            youngs_modulus_pa: 3e3,
            poisson_ratio: 0.45,
        };
        let clusters = Clusters::new(&mesh, &fat.into(), 2);
        (mesh, clusters)
    }

    fn deformed(mesh: &TetMesh, turn: [f64; 3], change: &Matrix3<f64>) -> Vec<[f64; 3]> {
        let turn = nalgebra::Rotation3::new(Vector3::from(turn)).into_inner();
        let bend = |p: &[f64; 3]| Vector3::new(20.0 * p[1] * p[2], -10.0 * p[0] * p[0], 0.0);
        let of = |p: &[f64; 3]| turn * (change * Vector3::from(*p) + bend(p));
        mesh.points_m().iter().map(|p| of(p).into()).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_pull_is_the_gradient_and_has_no_sum_and_no_moment(
            turn in proptest::array::uniform3(-2.0..2.0),
            change in proptest::array::uniform9(-0.3..0.3),
            way in proptest::array::uniform3(-1.0..1.0),
        ) {
            let (mesh, clusters) = body();
            let x = deformed(&mesh, turn, &(Matrix3::identity() + Matrix3::from_row_slice(&change)));
            let mut force = vec![[0.0; 3]; x.len()];
            pull(&clusters, &x, &mut force).expect("finite");
            let direction = |node: usize| {
                let phase = node as f64;
                [way[0] * phase.sin(), way[1] * phase.cos(), way[2] * (2.0 * phase).sin()]
            };
            let (h, mut scratch) = (1e-7, force.clone());
            let mut at = |sign: f64| {
                let moved: Vec<[f64; 3]> = x.iter().enumerate()
                    .map(|(node, p)| [0, 1, 2].map(|k| p[k] + sign * h * direction(node)[k]))
                    .collect();
                pull(&clusters, &moved, &mut scratch).expect("finite")
            };
            let by_difference = (at(1.0) - at(-1.0)) / (2.0 * h);
            let exact: f64 = force.iter().enumerate()
                .map(|(node, f)| (0..3).map(|k| -f[k] * direction(node)[k]).sum::<f64>())
                .sum();
            let size: f64 = force.iter().flatten().map(|f| f.abs()).sum();
            prop_assert!((by_difference - exact).abs() < 1e-6 * size, "{by_difference} {exact}");
            let (mut sum, mut moment) = (Vector3::zeros(), Vector3::zeros());
            for (f, p) in force.iter().zip(&x) {
                sum += Vector3::from(*f);
                moment += Vector3::from(*p).cross(&Vector3::from(*f));
            }
            prop_assert!(sum.norm() < 1e-13 * size && moment.norm() < 1e-14 * size);
        }
    }

    #[test]
    fn a_small_strain_costs_half_e_strain_squared() {
        let (mesh, clusters) = body();
        let mut force = vec![[0.0; 3]; mesh.points_m().len()];
        for axis in 0..3 {
            let mut change = Matrix3::identity();
            change[(axis, axis)] += 1e-3;
            let x: Vec<[f64; 3]> = mesh
                .points_m()
                .iter()
                .map(|p| (change * Vector3::from(*p)).into())
                .collect();
            let energy = pull(&clusters, &x, &mut force).expect("finite");
            let expected = 0.5 * 3e3 * 1e-6 * 12e-6;
            // Clusters at the boundary are not round: each axis has its own second moment.
            assert!(
                (energy / expected - 1.0).abs() < 0.3,
                "{axis} {}",
                energy / expected
            );
        }
        // All three together are exact: the mean radius is what weights are made from.
        let x: Vec<[f64; 3]> = mesh
            .points_m()
            .iter()
            .map(|p| p.map(|value| 1.001 * value))
            .collect();
        let energy = pull(&clusters, &x, &mut force).expect("finite");
        assert!((energy / (1.5 * 3e3 * 1e-6 * 12e-6) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_number_has_no_pull() {
        let (mesh, clusters) = body();
        let mut x = mesh.points_m().to_vec();
        let mut force = vec![[0.0; 3]; x.len()];
        assert!(pull(&clusters, &x, &mut force).is_some_and(|energy| energy < 1e-25));
        x[3][1] = f64::NAN;
        assert_eq!(pull(&clusters, &x, &mut force), None);
    }
}
