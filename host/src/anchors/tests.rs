//! Rows on several anchors against explicit products with K^-1, and where turning tissue is without any.

use super::{
    AnchorPoint, AnchorSettings, ConstraintState, ConstraintSystem, MANY_PUSHES,
    MultiPointConstraint, PointConstraint, Term,
};
use crate::body::Body;
use crate::fem::{CorotationalTissue, HeldPoints, LinearTissue, Loads, Material, NodeLoad, Policy};
use crate::mesh::{TetMesh, slab};
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

/// A slab of linear tissue whose lowest nodes are fixed.
fn tissue() -> (TetMesh, Arc<LinearTissue>) {
    let mesh = slab([0.04, 0.03, 0.02], [4, 3, 2]).expect("a slab");
    let fixed: Vec<u32> = (0..20).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.4,
    };
    let tissue = Arc::new(LinearTissue::new(&mesh, material, &fixed).expect("tissue"));
    (mesh, tissue)
}

/// One, two and three single rows on an anchor and eight spread ones, on cells, faces and fixed nodes; one names an anchor twice and gives
/// way, three have what one of them has from one place on, as what a thread has beyond a place is, and what the last moves cancels, as that
/// of a straight thread does: it gives way, and next to nothing.
#[test]
fn spread_rows_give_way_as_products_with_the_inverse_say() {
    let (mesh, tissue) = tissue();
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
    let single = [
        (0, [0.6, 0.0, 0.8]),
        (0, [0.0, 1.0, 0.0]),
        (1, [1.0, 0.0, 0.0]),
        (1, [0.0, 0.8, 0.6]),
        (1, [0.0, -0.6, 0.8]),
        (2, [0.0, 1.0, 0.0]),
    ];
    let spread: [&[(usize, [f64; 3])]; 8] = [
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
        &[
            (0, [0.3, 1.0, 0.0]),
            (1, [0.0, 0.6, 0.8]),
            (2, [0.0, 1.0, 0.2]),
            (4, [-0.5, 0.0, 1.0]),
        ],
        &[
            (1, [0.0, 0.15, 0.2]),
            (2, [0.0, 1.0, 0.2]),
            (4, [-0.5, 0.0, 1.0]),
        ],
        &[(4, [-0.5, 0.0, 1.0])],
        &[(1, [0.0, 0.6, 0.8]), (1, [0.0, -0.6, -0.8])],
    ];
    let softness = [0.0, 0.0, 0.125, 0.5, 0.0, 0.0, 0.0, 0.0];

    let settings = AnchorSettings {
        most_rows: single.len(),
        most_anchors: 5,
        most_spread: 8,
        most_terms: 26,
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
    let mut id = 0..;
    let rows = single.map(|(anchor, direction)| PointConstraint {
        id: id.next().unwrap_or_default(),
        anchor,
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
    let count = single.len() + spread.len();
    let found = system.compliance(count);
    let targets_m = [0.25; 6].iter().chain(&[0.5; 8]).copied();
    assert!(system.delta_free_m(count).iter().copied().eq(targets_m));

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
            let own = match row.checked_sub(single.len()) {
                Some(spread) if row == column => softness[spread],
                _ => 0.0,
            };
            let off = (found[count * column + row] - along - own).abs();
            assert!(off < 1e-12 * largest, "{row} {column}: {off:e}");
        }
        assert!(found[(count + 1) * column] > 0.0, "{column}");
    }
}

/// Of many forces one solve takes the place of a sum for each vertex; both say the same, and the sums go on after the tissue has moved.
#[test]
fn tissue_that_many_forces_act_on_is_where_sums_of_columns_have_it() {
    let mesh = slab([0.06, 0.06, 0.02], [7, 7, 2]).expect("a slab");
    let fixed: Vec<u32> = (0..64).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.4,
    };
    let tissue = CorotationalTissue::new(&mesh, material, &fixed, Policy::default());
    let tissue = Arc::new(tissue.expect("tissue"));
    let loads = vec![0.0; tissue.unknowns()];
    let body = Body::Corotational { tissue, loads };
    let cells = mesh.cells().iter().rev().step_by(4).take(60);
    let anchors: Vec<AnchorPoint> = cells
        .map(|nodes| AnchorPoint {
            nodes: *nodes,
            weights: [0.1, 0.2, 0.3, 0.4],
        })
        .collect();
    let rows: Vec<PointConstraint> = (0..anchors.len() as u32)
        .map(|anchor| PointConstraint {
            id: u64::from(anchor),
            anchor,
            kind: RowKind::Equality,
            direction: if anchor % 2 == 0 {
                [1.0, 0.0, 0.0]
            } else {
                [0.0, 0.6, 0.8]
            },
            target_m: 2e-4 * f64::from(anchor % 7),
        })
        .collect();
    let settings = AnchorSettings {
        most_rows: rows.len(),
        most_anchors: anchors.len(),
        ..AnchorSettings::default()
    };
    let mut grasp = ConstraintState::new(body.at_rest(), &settings);
    let nodes = 0..body.numbering().nodes() as u32;
    let reached: Vec<u32> = nodes
        .filter(|node| !body.numbering().is_fixed(*node))
        .collect();
    let mut system =
        ConstraintSystem::new(&body, grasp.motion(), &reached, settings).expect("free nodes");
    system.begin_step();
    for pass in 0..3 {
        system.look(&body, &mut grasp).expect("tissue that turns");
        system.linearise(&body, &mut grasp).expect("the same");
        assert!(system.read(&body, &anchors, &[], &rows));
        assert!(system.fetch(&body, &grasp, usize::MAX).all);
        assert_eq!(grasp.motion().pushed().len() > MANY_PUSHES, pass > 0);
        let (mut largest, mut off): (f64, f64) = (0.0, 0.0);
        for (vertex, node) in (0u32..).zip(&reached) {
            let at = system.displacement(&body, &grasp, &[], *node);
            let sum = body.free(grasp.motion(), system.body_work(), system.columns(), vertex);
            largest = largest.max(sum.norm());
            off = off.max((at - sum).norm());
        }
        assert!(
            off <= 1e-12 * largest,
            "pass {pass}: {off:e} of {largest:e}"
        );
        system.assemble(&body, &grasp, &rows);
        system.solve(&rows, None, &mut grasp);
        system.accept(&body, &mut grasp);
    }
}

/// Blocks are kept while anchors come and go, and computed where one comes back to others that came meanwhile: to the bit what a
/// system finds that has kept nothing.
#[test]
fn compliance_does_not_depend_on_which_anchors_were_there_before() {
    const MOST: usize = 9;
    let (mesh, tissue) = tissue();
    let resting = vec![0.0; tissue.unknowns()];
    let body = Body::Linear { tissue, resting };
    let nodes = 0..body.numbering().nodes() as u32;
    let reached: Vec<u32> = nodes
        .filter(|node| !body.numbering().is_fixed(*node))
        .collect();
    let settings = AnchorSettings {
        most_rows: MOST,
        most_anchors: MOST,
        ..AnchorSettings::default()
    };
    let grasp = ConstraintState::new(body.at_rest(), &settings);
    let held = Arc::new(HeldPoints::none());
    let new = || {
        let motion = grasp.motion();
        ConstraintSystem::grouped(&body, motion, &held, &reached, settings, &[])
    };
    let compliance = |system: &mut ConstraintSystem, anchors: &[AnchorPoint]| {
        let rows: Vec<PointConstraint> = (0..anchors.len() as u32)
            .map(|anchor| PointConstraint {
                id: u64::from(anchor),
                anchor,
                kind: RowKind::Equality,
                direction: [0.36, 0.48, 0.8],
                target_m: 0.0,
            })
            .collect();
        assert!(system.read(&body, anchors, &[], &rows));
        system.begin_step();
        assert!(system.fetch(&body, &grasp, usize::MAX).all);
        system.assemble(&body, &grasp, &rows);
        system.compliance(rows.len()).to_vec()
    };
    let mut rng = fastrand::Rng::with_seed(5);
    let mut pool: Vec<AnchorPoint> = mesh
        .cells()
        .iter()
        .rev()
        .take(14)
        .copied()
        .map(|nodes| AnchorPoint {
            nodes,
            weights: [0.1, 0.2, 0.3, 0.4],
        })
        .collect();
    let mut system = new();
    for round in 0..200 {
        // Some stay away for long, and now and then one comes twice.
        rng.shuffle(&mut pool[..if round % 40 < 30 { 7 } else { 14 }]);
        let mut anchors = pool[..rng.usize(0..MOST)].to_vec();
        if let Some(first) = anchors.first().copied().filter(|_| round % 7 == 0) {
            anchors.push(first);
        }
        let found = compliance(&mut system, &anchors);
        assert_eq!(found, compliance(&mut new(), &anchors), "round {round}");
    }
}
