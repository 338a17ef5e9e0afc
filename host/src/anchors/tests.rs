//! Rows on several anchors against explicit products with K^-1.

use super::{
    AnchorPoint, AnchorSettings, ConstraintState, ConstraintSystem, MultiPointConstraint,
    PointConstraint, Term,
};
use crate::body::Body;
use crate::fem::{LinearTissue, Loads, Material, NodeLoad};
use crate::mesh::slab;
use crate::rows::RowKind;
use std::sync::Arc;

fn row_force(
    parts: &[(usize, [f64; 3])],
    anchors: &[AnchorPoint],
) -> impl Iterator<Item = NodeLoad> {
    parts.iter().flat_map(|(anchor, direction)| {
        let anchor = anchors[*anchor];
        let nodes = anchor.nodes.into_iter().zip(anchor.weights);
        nodes.map(move |(node, weight)| NodeLoad {
            node,
            force_n: direction.map(|x| x * weight),
        })
    })
}

/// Two single rows and four spread ones, on cells, faces and fixed nodes; one names an anchor twice and gives way.
#[test]
fn spread_rows_give_way_as_products_with_the_inverse_say() {
    let mesh = slab([0.04, 0.03, 0.02], [4, 3, 2]).expect("a slab");
    let fixed: Vec<u32> = (0..20).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.4,
    };
    let tissue = Arc::new(LinearTissue::new(&mesh, material, &fixed).expect("tissue"));
    let cell = |index: usize| mesh.cells()[index];
    let last = mesh.cells().len() - 1;
    let anchors = [
        (cell(last), [0.1, 0.2, 0.3, 0.4]),
        (cell(last / 2), [0.5, 0.0, 0.25, 0.25]),
        // Partly fixed, and wholly.
        (cell(0), [0.25; 4]),
        ([0, 1, 2, 3], [0.25; 4]),
        (cell(last - 3), [0.0, 0.0, 0.0, 1.0]),
    ]
    .map(|(nodes, weights)| AnchorPoint { nodes, weights });
    let single = [(0, [0.6, 0.0, 0.8]), (2, [0.0, 1.0, 0.0])];
    let spread: [&[(usize, [f64; 3])]; 4] = [
        &[(0, [1.0, 0.0, 0.0]), (4, [-1.0, 0.0, 0.0])],
        &[
            (4, [0.0, 2.0, 0.5]),
            (1, [0.3, -1.0, 0.0]),
            (2, [1.0, 1.0, 1.0]),
            (3, [0.0, 0.0, 1.0]),
        ],
        &[
            (1, [0.0, 0.0, 1.0]),
            (1, [0.5, 0.0, 0.0]),
            (0, [0.0, 0.1, 0.0]),
        ],
        &[],
    ];
    let softness = [0.0, 0.0, 0.125, 0.5];

    let settings = AnchorSettings {
        most_rows: 2,
        most_anchors: 5,
        most_spread: 4,
        most_terms: 16,
        ..AnchorSettings::default()
    };
    let resting = vec![0.0; tissue.unknowns()];
    let body = Body::Linear {
        tissue: tissue.clone(),
        resting,
    };
    let grasp = ConstraintState::new(body.at_rest(), &settings);
    let mut system = {
        let nodes = 0..body.numbering().nodes() as u32;
        let reached: Vec<u32> = nodes
            .filter(|node| !body.numbering().is_fixed(*node))
            .collect();
        ConstraintSystem::new(&body, grasp.motion(), &reached, settings).expect("free nodes")
    };
    let rows = single.map(|(anchor, direction)| PointConstraint {
        id: anchor,
        anchor: anchor as u32,
        kind: RowKind::Equality,
        direction,
        target_m: 0.25,
    });
    let (mut terms, mut spread_rows) = (Vec::new(), Vec::new());
    for (index, parts) in spread.iter().enumerate() {
        let first = terms.len() as u32;
        terms.extend(parts.iter().map(|(anchor, direction)| Term {
            anchor: *anchor as u32,
            direction: *direction,
        }));
        spread_rows.push(MultiPointConstraint {
            id: 10 + index as u64,
            kind: RowKind::Equality,
            target_m: 0.5,
            compliance_m_per_n: softness[index],
            terms: (first, parts.len() as u32),
        });
    }
    assert!(system.read(&body, &anchors, &[], &rows) && system.read_spread(&spread_rows, &terms));
    system.begin_step();
    assert!(system.fetch(&body, &grasp, usize::MAX).all);
    system.assemble(&body, &grasp, &rows);
    let found = system.compliance(6);
    assert_eq!(system.delta_free_m(6), [0.25, 0.25, 0.5, 0.5, 0.5, 0.5]);

    let all: Vec<Vec<(usize, [f64; 3])>> = single
        .iter()
        .map(|(anchor, direction)| vec![(*anchor as usize, *direction)])
        .chain(spread.iter().map(|parts| parts.to_vec()))
        .collect();
    let largest = found.iter().fold(0.0f64, |most, w| most.max(w.abs()));
    for (column, pushed) in all.iter().enumerate() {
        let loads = Loads {
            forces: row_force(pushed, &anchors).collect(),
            ..Loads::default()
        };
        let moved = tissue.solve(&loads).expect("a balance").displacement_m;
        for (row, felt) in all.iter().enumerate() {
            let along: f64 = row_force(felt, &anchors)
                .map(|load| {
                    let u = moved[load.node as usize];
                    (0..3).map(|axis| u[axis] * load.force_n[axis]).sum::<f64>()
                })
                .sum();
            let own = if row == column && row >= 2 {
                softness[row - 2]
            } else {
                0.0
            };
            let off = (found[6 * column + row] - along - own).abs();
            assert!(off < 1e-12 * largest, "{row} {column}: {off:e}");
        }
    }
}
