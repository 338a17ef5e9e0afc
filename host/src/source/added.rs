//! Sources that scenes add by a key of their own, and what these build on.
//!
//! Entry points: [`Section`] for the key, [`Added`] for the source, `scene_keys` for its registration.

use super::Source;
use crate::anchors::{AnchorPoint, ConstraintSet, PointConstraint};
use crate::mesh::TetMesh;
use crate::rows::RowKind;
use nalgebra::Vector3;
use std::fmt;
use std::sync::Arc;

/// What an added source keeps from step to step.
pub(crate) type Kept = [f64; 8];

/// A source that a scene adds.
pub(crate) trait Added: Source + fmt::Debug + Send {
    /// What it keeps before the first step, with points of the tissue where `rest` says \[m\].
    fn begin(&self, rest: &dyn Fn(&AnchorPoint) -> Vector3<f64>, kept: &mut Kept);

    /// Its name, and why a scene has it: for `scene explain`.
    fn explain(&self) -> (String, String);

    /// What it reports, with units in the names.
    fn values(&self, kept: &Kept) -> Vec<(&'static str, f64)>;
}

/// What a scene says of an added source: the type of its key.
pub(crate) trait Section {
    /// Builds it as the `index`th of all added sources of a scene.
    ///
    /// # Errors
    /// What is wrong with it, with the key, the value and the limit.
    fn build(&self, index: usize, mesh: &TetMesh) -> Result<Arc<dyn Added>, String>;
}

// ANCHOR: keys
/// Keys by which scenes add sources, one line each: `/// What it is. key: its section;`.
macro_rules! scene_keys {
    ($with:ident) => {
        $with! {
            /// Springs between two points.
            spring: crate::source::SpringSection;
        }
    };
}
// ANCHOR_END: keys
pub(crate) use scene_keys;

/// Bit of a row's id that no other source's rows have.
const ID: u64 = 1 << 51;

/// Appends rows of the `index`th added source on the way between two points, or from one to a fixed place: for each its
/// direction, what it is to come to \[m\], and its stiffness \[N/m\]; those without stiffness are left out.
pub(super) fn append_way(
    set: &mut ConstraintSet,
    index: usize,
    ends: [Option<AnchorPoint>; 2],
    rows: [(Vector3<f64>, f64, f64); 3],
) {
    let anchor = set.add_way(ends);
    for (row, (direction, target_m, stiffness_n_per_m)) in (0u64..).zip(rows) {
        if stiffness_n_per_m > 0.0 {
            let place = set.rows.len() as u32;
            set.soft.push((place, stiffness_n_per_m.recip()));
            set.rows.push(PointConstraint {
                id: ID | (index as u64) << 16 | row,
                anchor,
                kind: RowKind::Equality,
                direction: direction.into(),
                target_m,
            });
        }
    }
}

/// The node nearest to a place of the unloaded mesh \[m\].
///
/// # Errors
/// The `key`, the distance and the limit, for a place farther from all nodes than the longest edge: no point of the tissue is.
pub(super) fn nearest_node(
    mesh: &TetMesh,
    key: &str,
    place_m: [f64; 3],
) -> Result<AnchorPoint, String> {
    let place = Vector3::from(place_m);
    let far = |at: &[f64; 3]| (Vector3::from(*at) - place).norm_squared();
    let nodes = (0u32..).zip(mesh.points_m());
    let nearest = nodes.min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
    let node = nearest.map_or(0, |(node, _)| node);
    let far_m = nearest.map_or(0.0, |(_, at)| far(at).sqrt());
    let longest_m = longest_edge_m(mesh);
    if far_m > longest_m {
        return Err(format!(
            "`{key}` is {far_m:.4} m from the nearest node, and the mesh's longest edge has {longest_m:.4} m: it is a place of the tissue in metres"
        ));
    }
    Ok(AnchorPoint {
        nodes: [node; 4],
        weights: [1.0, 0.0, 0.0, 0.0],
    })
}

/// Farthest fixed point from the tissue \[m\].
const FARTHEST_M: f64 = 2.0;

/// Checks that a fixed point is near the tissue.
///
/// # Errors
/// Its distance from the nearest node and the limit, in words.
pub(super) fn check_near(mesh: &TetMesh, key: &str, place_m: [f64; 3]) -> Result<(), String> {
    let place = Vector3::from(place_m);
    let far = |at: &[f64; 3]| Vector3::from(*at).metric_distance(&place);
    let far_m = mesh
        .points_m()
        .iter()
        .map(far)
        .fold(f64::INFINITY, f64::min);
    match far_m <= FARTHEST_M {
        true => Ok(()),
        false => Err(format!(
            "`{key}` is {far_m:.4} m from the nearest node, and at most {FARTHEST_M} m are taken: lengths are in metres"
        )),
    }
}

/// Longest edge of a mesh's cells \[m\].
fn longest_edge_m(mesh: &TetMesh) -> f64 {
    let at = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
    let edges = mesh.cells().iter().flat_map(|cell| {
        let pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
        pairs.map(|(a, b)| at(cell[a]).metric_distance(&at(cell[b])))
    });
    edges.fold(0.0, f64::max)
}

/// Unit vectors along a way and across it, right-handed.
pub(super) fn frame_along(way: &Vector3<f64>) -> [Vector3<f64>; 3] {
    let along = way.try_normalize(0.0).unwrap_or_else(Vector3::z);
    let other = Vector3::ith(along.iamin(), 1.0);
    let across = along.cross(&other).normalize();
    [along, across, along.cross(&across)]
}

/// Refuses a number outside of `(above, below)`.
///
/// # Errors
/// The key, its value and the limits.
pub(super) fn check_between(
    key: &str,
    value: f64,
    (above, below): (f64, f64),
) -> Result<(), String> {
    if value > above && value < below {
        return Ok(());
    }
    Err(format!(
        "`{key}` is {value}; it must be above {above} and below {below}"
    ))
}
