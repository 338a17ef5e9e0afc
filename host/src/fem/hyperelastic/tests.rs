//! The tangent of free nodes, a look and a move, against the energy and the reference's own solver.

use super::super::corotational::dot;
use super::super::loads::{Loads, NodeLoad};
use super::*;
use crate::mesh::slab;
use sutura_models::Material;

const SOFT: Material = Material {
    youngs_modulus_pa: 8e3,
    poisson_ratio: 0.45,
};
const CELLS: [Cells; 2] = [Cells::Linear, Cells::Averaged];

fn block() -> TetMesh {
    slab([0.04, 0.04, 0.02], [3, 3, 2]).expect("a slab")
}

/// Held at its bottom, by nodes that are not the first.
fn bottom(mesh: &TetMesh) -> Vec<u32> {
    let low = mesh
        .points_m()
        .iter()
        .map(|p| p[2])
        .fold(f64::MAX, f64::min);
    let nodes = (0u32..).zip(mesh.points_m());
    nodes
        .filter(|(_, p)| p[2] < low + 1e-9)
        .map(|(node, _)| node)
        .collect()
}

fn tissue(cells: Cells, policy: Policy) -> HyperelasticTissue {
    let (mesh, laws) = (block(), [Law::neo_hookean(SOFT)]);
    let substance = Hyperelasticity { laws: &laws, cells };
    HyperelasticTissue::new(&mesh, &substance, &bottom(&mesh), policy).expect("tissue")
}

fn wave(unknowns: usize, seed: f64) -> Vec<f64> {
    (0..unknowns)
        .map(|index| (seed + 1.7 * index as f64).sin())
        .collect()
}

/// Internal forces are the slope of the energy, the assembled tangent and the product cell by cell theirs.
#[test]
fn forces_and_tangent_are_derivatives() {
    for cells in CELLS {
        let tissue = tissue(cells, Policy::default());
        let n = tissue.unknowns();
        let (bent, way) = (wave(n, 0.3), wave(n, 5.0));
        let at = |share: f64| {
            let mut state = tissue.state();
            let ends = bent.iter().zip(&way);
            for (u, (bent, way)) in state.unknowns_mut().iter_mut().zip(ends) {
                *u = 5e-4 * bent + share * way;
            }
            state
        };
        let mut work = tissue.workspace();
        let h = 1e-8;
        let [ahead, behind] = [h, -h].map(|share| {
            let energy = tissue.energy_j(&at(share), &mut work);
            (energy, work.internal.clone())
        });
        let state = at(0.0);
        tissue.update(&state, &mut work);
        let slope = dot(&work.internal, &way);
        let by_difference = (ahead.0 - behind.0) / (2.0 * h);
        let size = dot(&work.internal, &work.internal).sqrt();
        assert!((slope - by_difference).abs() < 1e-5 * size, "{cells:?}");

        tissue.assemble(&mut work, TangentKind::Consistent);
        let mut product = vec![0.0; n];
        tissue.pattern.multiply(&work.stiffness, &way, &mut product);
        let differences = ahead.1.iter().zip(&behind.1);
        let off: Vec<f64> = product
            .iter()
            .zip(differences)
            .map(|(product, (ahead, behind))| product - (ahead - behind) / (2.0 * h))
            .collect();
        let size = dot(&product, &product).sqrt();
        assert!(dot(&off, &off).sqrt() < 1e-6 * size, "{cells:?}");

        work.search.copy_from_slice(&way);
        tissue.multiply(&mut work);
        let off: Vec<f64> = product
            .iter()
            .zip(&work.product)
            .map(|(a, b)| a - b)
            .collect();
        assert!(dot(&off, &off).sqrt() < 1e-12 * size, "{cells:?}");
    }
}

/// Where one end is pressed so hard that the tangent is not positive definite, the factor answers at the other end as if it were not.
/// A share of the diagonal, as much as is needed there, makes all of it stiff.
#[test]
fn what_is_pressed_at_one_end_is_as_soft_as_before_at_the_other() {
    let mesh = slab([0.02, 0.02, 0.08], [2, 2, 8]).expect("a slab");
    let heights = mesh.points_m().iter().map(|p| p[2]);
    let lowest = heights.fold(f64::INFINITY, f64::min);
    for cells in CELLS {
        let laws = [Law::neo_hookean(SOFT)];
        let substance = Hyperelasticity { laws: &laws, cells };
        let tissue = HyperelasticTissue::new(&mesh, &substance, &bottom(&mesh), Policy::default());
        let tissue = tissue.expect("tissue");
        let n = tissue.unknowns();
        let mut work = tissue.workspace();
        let mut answer = |pressed: f64| {
            let mut state = tissue.state();
            let places = tissue.node.clone();
            for (u, &node) in state.unknowns_mut().chunks_exact_mut(3).zip(&places) {
                let height = mesh.points_m()[node as usize][2] - lowest;
                // The lowest layer loses so much of its height, all above comes with it.
                u[2] = -pressed * height.min(0.01);
            }
            state.moved = true;
            tissue.update(&state, &mut work);
            assert!(tissue.refactor(&mut state, &mut work), "{cells:?}");
            // Unit forces that stretch the upper half.
            let mut z = vec![0.0; n];
            for (z, &node) in z.chunks_exact_mut(3).zip(&places) {
                let height = mesh.points_m()[node as usize][2] - lowest;
                z[2] = f64::from(height > 0.079) - f64::from((height - 0.04).abs() < 1e-9);
            }
            let force = z.clone();
            state.factor.solve(&mut z, &mut work.solve);
            (state.tangent, dot(&z, &force))
        };
        let (kind, free) = answer(0.0);
        assert_eq!(kind, TangentKind::Consistent);
        let (kind, pressed) = answer(0.75);
        assert_eq!(kind, TangentKind::Projected, "{cells:?}");
        assert!(
            (pressed / free - 1.0).abs() < 0.05,
            "{cells:?}: {pressed} {free}"
        );
    }
}

/// Linearise and accept until in balance: the reference's balance, and quadratic at the end with a factor that is always
/// fresh.
#[test]
fn passes_end_where_the_reference_does() {
    let fresh = Policy {
        refactor_rotation_rad: 0.0,
        refactor_every: 0,
        cg_iterations: 0,
        cg_tolerance: 0.0,
    };
    for cells in CELLS {
        for policy in [fresh, Policy::default()] {
            let tissue = tissue(cells, policy);
            let loads = Loads {
                forces: [(40, [0.02, 0.01, 0.03]), (45, [0.0, 0.02, -0.04])]
                    .map(|(node, force_n)| NodeLoad { node, force_n })
                    .to_vec(),
                ..Loads::default()
            };
            let laws = [Law::neo_hookean(SOFT)];
            let substance = Hyperelasticity { laws: &laws, cells };
            let mut expected = tissue.state();
            tissue
                .settle(&mut expected, &block(), &substance, &loads)
                .expect("a balance");
            let external = loads.on_unknowns(tissue.numbering()).expect("loads");
            let (mut state, mut work) = (tissue.state(), tissue.workspace());
            let change = vec![0.0; tissue.unknowns()];
            let mut residuals = Vec::new();
            for _ in 0..60 {
                let balance = tissue.look(&state, &mut work, &external);
                residuals.push(balance.imbalance);
                if balance.imbalance < 1e-11 {
                    break;
                }
                let report = tissue.answer(&mut state, &mut work);
                assert!(report.sound);
                let moved = tissue.accept(&mut state, &mut work, &external, &change);
                assert_ne!(moved, Moved::Not);
            }
            println!("{cells:?} {residuals:?}");
            let size = expected
                .unknowns()
                .iter()
                .fold(0.0, |m: f64, u| m.max(u.abs()));
            assert!(size > 5e-4, "large: {size}");
            for (found, expected) in state.unknowns().iter().zip(expected.unknowns()) {
                assert!((found - expected).abs() < 1e-8 * size, "{found} {expected}");
            }
            if policy == fresh {
                let quadratic = residuals
                    .windows(2)
                    .any(|two| two[0] < 0.05 && two[0] > 1e-5 && two[1] < 30.0 * two[0] * two[0]);
                assert!(quadratic && residuals.len() < 12, "{residuals:?}");
            }
        }
    }
}

/// A force that would turn cells inside out moves the tissue a part of its way; one beyond all measure nowhere.
#[test]
fn no_cell_is_ever_inverted() {
    let tissue = tissue(Cells::Linear, Policy::default());
    let mut work = tissue.workspace();
    let mut pushed = |force_n: f64| {
        let mut state = tissue.state();
        let mut external = vec![0.0; tissue.unknowns()];
        external[3 * 20 + 2] = -force_n;
        tissue.linearise(&mut state, &mut work, &external);
        let change = vec![0.0; tissue.unknowns()];
        let moved = tissue.accept(&mut state, &mut work, &external, &change);
        tissue.update(&state, &mut work);
        let upright = work.deformed.iter().all(|f| f.determinant() > 0.0);
        assert!(upright, "{force_n} N: {moved:?}");
        (moved, state)
    };
    assert_eq!(pushed(0.01).0, Moved::Whole);
    assert_eq!(pushed(10.0).0, Moved::Part);
    let rest = tissue.state();
    for force_n in [1e6, f64::NAN, f64::INFINITY] {
        let (moved, state) = pushed(force_n);
        assert_eq!(moved, Moved::Not, "{force_n}");
        assert_eq!(state.unknowns(), rest.unknowns());
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let (mesh, laws) = (block(), [Law::neo_hookean(SOFT); 2]);
    let of = |laws, cells| {
        let substance = Hyperelasticity { laws, cells };
        HyperelasticTissue::new(&mesh, &substance, &bottom(&mesh), Policy::default()).map(drop)
    };
    for (laws, cells) in [(&laws[..], Cells::Linear), (&laws[..1], Cells::Quadratic)] {
        let found = of(laws, cells);
        assert!(
            matches!(found, Err(TissueError::Elasticity(_))),
            "{found:?}"
        );
    }
    let substance = Hyperelasticity {
        laws: &laws[..1],
        cells: Cells::Linear,
    };
    let floating = HyperelasticTissue::new(&mesh, &substance, &[0, 1], Policy::default());
    assert!(matches!(floating, Err(TissueError::Floating { fixed: 2 })));
}
