//! Where a tool comes from that was nowhere before. Entry point: [`way_in`].

use super::shape::Solid;
use nalgebra::Vector3;

/// Times that the way is doubled: any mesh is left behind by then.
const MOST_DOUBLINGS: u32 = 40;

/// The point of the tissue next to a tool.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nearest {
    /// Where it is \[m\], (3).
    pub at: Vector3<f64>,
    /// Out of the tissue there, (3).
    pub normal: Vector3<f64>,
    /// How far it is from the tool, below zero inside that \[m\].
    pub gap_m: f64,
}

/// How far off lies a free place from which a tool can come straight to where `solid` is \[m\], (3): back along the normal
/// of the nearest point, which is the shortest way out for one that is inside the tissue. `None` if no such place is found.
pub(crate) fn way_in(
    solid: &Solid,
    nearest: impl Fn(&Solid) -> Option<Nearest>,
    is_inside: impl Fn(&Vector3<f64>) -> bool,
) -> Option<Vector3<f64>> {
    let Some(near) = nearest(solid) else {
        return Some(Vector3::zeros());
    };
    let middle = solid.middle();
    let mut back = if is_inside(&middle) {
        (near.at - middle).norm() + solid.radius()
    } else {
        (-near.gap_m).max(0.0)
    };
    for _ in 0..MOST_DOUBLINGS {
        let start = solid.moved(&(near.normal * back));
        let is_free = nearest(&start).is_none_or(|near| near.gap_m >= 0.0);
        if is_free && !is_inside(&start.middle()) {
            return Some(near.normal * back);
        }
        back = 2.0 * back.max(0.1 * solid.radius());
    }
    None
}
