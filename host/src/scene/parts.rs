//! `[[mesh.part]]`: slabs and tubes beside each other, each a region of its own.
//!
//! Entry point: [`read_parts`].

use super::document::{Document, SceneError};
use crate::mesh::{self, RawMesh, TetMesh};
use sutura_scene_file::scene::{Axis, PartSection, SlabSection, TubeSection};
use toml::Spanned;

/// Most cubes of a part: five million cells, far above what any solver here can do.
const MOST_CUBES: usize = 1_000_000;

/// All parts as one mesh, their nodes and cells in the order of the list.
///
/// # Errors
/// A flaw at what is no slab or tube.
pub(super) fn read_parts(
    document: &Document,
    sections: &[Spanned<PartSection>],
) -> Result<TetMesh, SceneError> {
    let mut whole = RawMesh::default();
    for (number, section) in (1i64..).zip(sections) {
        let part = read_part(document, section)?;
        let at = match &section.get_ref().at_m {
            Some(at) => document.finite("at_m", at)?,
            None => [0.0; 3],
        };
        let first = whole.points_m.len() as u32;
        let moved = |x: &[f64; 3]| std::array::from_fn(|i| x[i] + at[i]);
        whole.points_m.extend(part.points_m().iter().map(moved));
        let cells = part.cells().iter().map(|cell| cell.map(|n| n + first));
        whole.cells.extend(cells);
        whole.regions.resize(whole.cells.len(), number);
        if let Some(name) = &section.get_ref().name {
            whole.region_names.insert(number, name.clone());
        }
    }
    whole.check().map_err(|error| {
        let span = sections.first().map_or(0..0, Spanned::span);
        document.flaw(span, error.to_string(), "these parts", None)
    })
}

fn read_part(document: &Document, section: &Spanned<PartSection>) -> Result<TetMesh, SceneError> {
    match section.get_ref() {
        PartSection {
            slab: Some(slab),
            tube: None,
            ..
        } => read_slab(document, slab),
        PartSection {
            slab: None,
            tube: Some(tube),
            ..
        } => read_tube(document, tube),
        _ => {
            let help = "give `slab = { .. }` or `tube = { .. }`, and another `[[mesh.part]]` for another one";
            let message = "a part is one slab or one tube";
            Err(document.flaw(section.span(), message, "slab or tube", Some(help)))
        }
    }
}

/// A structured slab, centred in x and y, top at z = 0.
///
/// # Errors
/// A flaw at lengths or divisions that make none.
pub(super) fn read_slab(
    document: &Document,
    slab: &Spanned<SlabSection>,
) -> Result<TetMesh, SceneError> {
    let (size, divisions) = (&slab.get_ref().size_m, &slab.get_ref().divisions);
    let help = "size along x, y, z in metres";
    if document.finite("size_m", size)?.iter().any(|s| *s <= 0.0) {
        let message = "size_m: every length must be positive";
        return Err(document.flaw(size.span(), message, "must be positive", Some(help)));
    }
    check_divisions(document, divisions)?;
    mesh::slab(*size.get_ref(), *divisions.get_ref())
        .map_err(|e| document.flaw(slab.span(), e.to_string(), "this slab", Some(help)))
}

fn check_divisions(document: &Document, divisions: &Spanned<[usize; 3]>) -> Result<(), SceneError> {
    let cubes = divisions
        .get_ref()
        .iter()
        .try_fold(1usize, |n, d| n.checked_mul(*d));
    if cubes.is_some_and(|n| (1..=MOST_CUBES).contains(&n)) {
        return Ok(());
    }
    let message = "divisions: must be 1 or more along each axis, a million cubes at most";
    let help = "a slab of 20 x 20 x 8 cubes steps at some hundred hertz";
    Err(document.flaw(divisions.span(), message, "not usable", Some(help)))
}

fn read_tube(document: &Document, tube: &Spanned<TubeSection>) -> Result<TetMesh, SceneError> {
    let TubeSection {
        radii_m,
        length_m,
        divisions,
        axis,
    } = tube.get_ref();
    let [inner, outer] = document.finite("radii_m", radii_m)?;
    if !(0.0 < inner && inner < outer) {
        let message = "radii_m: the inner radius must be positive, the outer one larger";
        let help = "[inner, outer] in metres";
        return Err(document.flaw(radii_m.span(), message, "no wall", Some(help)));
    }
    let help = "along the tube's axis, in metres";
    let length = document.number("length_m", length_m, "positive", |l| l > 0.0, help)?;
    check_divisions(document, divisions)?;
    let half = 0.5 * length;
    let upright = mesh::tube([inner, outer], [-half, half], *divisions.get_ref());
    let upright = upright.map_err(|error| {
        let help = "at least 3 around: `divisions` are those along radius, circumference and axis";
        document.flaw(tube.span(), error.to_string(), "this tube", Some(help))
    })?;
    // Turned about the diagonal, so that cells keep their orientation.
    let turned = |x: &[f64; 3]| {
        let mut x = *x;
        x.rotate_right(match axis.unwrap_or(Axis::Z) {
            Axis::X => 1,
            Axis::Y => 2,
            Axis::Z => 0,
        });
        x
    };
    let points_m = upright.points_m().iter().map(turned).collect();
    TetMesh::new(points_m, upright.cells().to_vec())
        .map_err(|error| document.flaw(tube.span(), error.to_string(), "this tube", None))
}
