//! The assembled tangent against the product cell by cell, of either kind.

use super::*;
use crate::fem::Material;
use crate::mesh::slab;

/// A number in -1..1 that looks random.
fn noise(index: usize) -> f64 {
    (7919.7 * (index as f64 + 0.3).sin()).fract()
}

#[test]
fn the_assembled_tangent_is_the_product_cell_by_cell() {
    let mesh = slab([0.04, 0.03, 0.02], [3, 2, 2]).expect("a slab");
    let material = Material {
        youngs_modulus_pa: 5e3,
        poisson_ratio: 0.4,
    };
    let tissue =
        CorotationalTissue::new(&mesh, material, &[0, 1, 2, 5], Policy::default()).expect("tissue");
    let mut state = tissue.state();
    let mut workspace = tissue.workspace();
    for (index, u) in state.unknowns_mut().iter_mut().enumerate() {
        *u = 4e-3 * noise(index);
    }
    tissue.update(&mut state, &mut workspace);
    let unknowns = tissue.unknowns();
    let v: Vec<f64> = (0..unknowns).map(|index| noise(index + 5000)).collect();
    let mut kinds = Vec::new();
    for kind in [TangentKind::Consistent, TangentKind::Projected] {
        tissue.assemble(&mut workspace, kind);
        let mut assembled = vec![0.0; unknowns];
        tissue
            .pattern
            .multiply(&workspace.stiffness, &v, &mut assembled);
        tissue.find_twist(&mut workspace, kind);
        workspace.direction.as_flattened_mut()[..unknowns].copy_from_slice(&v);
        tissue.multiply(&mut workspace);
        let product = &workspace.product.as_flattened()[..unknowns];
        let scale = dot(product, product).sqrt();
        for (row, (a, b)) in assembled.iter().zip(product).enumerate() {
            assert!(
                (a - b).abs() < 1e-13 * scale,
                "{kind:?}, row {row}: {a} {b}"
            );
        }
        kinds.push(assembled);
    }
    assert_ne!(kinds[0], kinds[1], "some cells are compressed");
}

#[test]
fn at_rest_the_tangent_is_the_stiffness_of_linear_tissue() {
    let mesh = slab([0.04, 0.03, 0.02], [3, 2, 2]).expect("a slab");
    let material = Material {
        youngs_modulus_pa: 5e3,
        poisson_ratio: 0.4,
    };
    let tissue =
        CorotationalTissue::new(&mesh, material, &[0, 1, 2, 5], Policy::default()).expect("tissue");
    let mut workspace = tissue.workspace();
    let (_, linear) = assemble(&tissue.elements, tissue.numbering.free());
    let scale = linear.iter().fold(0.0f64, |most, k| most.max(k.abs()));
    for kind in [TangentKind::Consistent, TangentKind::Projected] {
        tissue.update(&mut tissue.state(), &mut workspace);
        tissue.assemble(&mut workspace, kind);
        for (a, b) in workspace.stiffness.iter().zip(&linear) {
            assert!((a - b).abs() < 1e-14 * scale, "{kind:?}: {a} {b}");
        }
    }
}
