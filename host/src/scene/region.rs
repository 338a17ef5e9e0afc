//! What each cell is made of: the material of `[tissue]`, or that of a `[[region]]`.
//!
//! Entry point: [`read_materials`]. Where two regions share a cell, the later section has it.

use super::document::{Document, Flaw, SceneError, nearest};
use crate::fem::{Material, Materials};
use crate::mesh::TetMesh;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use sutura_scene_file::scene::{Cuboid, RegionSection, RegionTag, TissueSection};
use toml::Spanned;

/// Cells with a material of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Its tag, name or box, for people.
    pub name: String,
    /// Its material.
    pub material: Material,
    /// How many cells are made of it.
    pub cells: usize,
}

/// What the cells are made of.
pub(super) struct Made {
    pub materials: Materials,
    pub regions: Vec<Region>,
    /// 0 for `[tissue]`, else which `[[region]]` in the order of the file, from 1, (m).
    pub of_cell: Vec<u32>,
}

/// The materials of all cells, and every region with what it holds in the end.
///
/// # Errors
/// A flaw at a number that is no modulus or ratio, at a tag that the mesh does not have, at a region that
/// says nothing, two things, or holds no cell.
pub(super) fn read_materials(
    document: &Document,
    mesh: &TetMesh,
    tissue: &TissueSection,
    sections: &[Spanned<RegionSection>],
    warnings: &mut Vec<Flaw>,
) -> Result<Made, SceneError> {
    let everywhere = read_material(document, &tissue.youngs_modulus_pa, &tissue.poisson_ratio)?;
    if sections.is_empty() {
        return Ok(Made {
            materials: everywhere.into(),
            regions: Vec::new(),
            of_cell: vec![0; mesh.cells().len()],
        });
    }
    let mut list = vec![everywhere];
    let mut of_cell = vec![0; mesh.cells().len()];
    let mut regions = Vec::with_capacity(sections.len());
    for (index, section) in (1u32..).zip(sections) {
        let RegionSection {
            tag,
            cuboid,
            youngs_modulus_pa,
            poisson_ratio,
            density_kg_per_m3: _,
            needle: _,
        } = section.get_ref();
        let material = read_material(document, youngs_modulus_pa, poisson_ratio)?;
        let (name, cells) = match (tag, cuboid) {
            (Some(tag), None) => (tag.get_ref().to_string(), tagged(document, mesh, tag)?),
            (None, Some(cuboid)) => ("box".to_owned(), inside(document, mesh, cuboid)?),
            _ => {
                let help = "give either `tag`, a region of the mesh, or `box`";
                let message = "a region says one thing";
                return Err(document.flaw(section.span(), message, "here", Some(help)));
            }
        };
        for cell in cells {
            of_cell[cell] = index;
        }
        list.push(material);
        regions.push(Region {
            name,
            material,
            cells: 0,
        });
    }
    for &index in &of_cell {
        if let Some(region) = (index as usize)
            .checked_sub(1)
            .and_then(|i| regions.get_mut(i))
        {
            region.cells += 1;
        }
    }
    for (region, section) in regions.iter().zip(sections) {
        if region.cells == 0 {
            let help =
                "where two regions share a cell, the later section has it: change their order";
            let message = "no cell is made of this region's material";
            warnings.push(document.warning(section.span(), message, "all in later regions", help));
        }
    }
    Ok(Made {
        materials: Materials::by_cell(list, of_cell.clone()),
        regions,
        of_cell,
    })
}

fn read_material(
    document: &Document,
    youngs_modulus_pa: &Spanned<f64>,
    poisson_ratio: &Spanned<f64>,
) -> Result<Material, SceneError> {
    let youngs_modulus_pa = document.number(
        "youngs_modulus_pa",
        youngs_modulus_pa,
        "positive",
        |e| e > 0.0,
        "soft tissue has 1e3 to 1e6 Pa: liver about 5e3, muscle 2e4, skin 2e5",
    )?;
    let poisson_ratio = document.number(
        "poisson_ratio",
        poisson_ratio,
        "more than -1 and less than 0.5",
        |nu| nu > -1.0 && nu < 0.5,
        "0.5 is incompressible, which these elements cannot be; soft tissue does well with 0.45",
    )?;
    Ok(Material {
        youngs_modulus_pa,
        poisson_ratio,
    })
}

/// The cells that the mesh file has given this number or name, ascending.
pub(super) fn tagged(
    document: &Document,
    mesh: &TetMesh,
    tag: &Spanned<RegionTag>,
) -> Result<Vec<usize>, SceneError> {
    let named = |region: &i64| match tag.get_ref() {
        RegionTag::Number(number) => region == number,
        RegionTag::Name(name) => mesh.region_names().get(region) == Some(name),
    };
    let cells: Vec<usize> = where_cell(mesh.regions().iter().copied(), named);
    if !cells.is_empty() {
        return Ok(cells);
    }
    let message = format!("the mesh has no region {}", tag.get_ref());
    let help = known_regions(mesh, tag.get_ref());
    Err(document.flaw(tag.span(), message, "no such region", Some(&help)))
}

/// The cells whose centroid is in the box.
fn inside(
    document: &Document,
    mesh: &TetMesh,
    cuboid: &Spanned<Cuboid>,
) -> Result<Vec<usize>, SceneError> {
    let centroids = mesh
        .cells()
        .iter()
        .map(|cell| mesh.corners(*cell).iter().sum::<Vector3<f64>>() / 4.0);
    let cells = where_cell(centroids, |x| cuboid.get_ref().contains((*x).into()));
    if cells.is_empty() {
        let message = "this region holds no cell of the mesh";
        let help = "a cell belongs to the box that its centroid lies in; `sutura mesh info` shows the mesh's size";
        return Err(document.flaw(cuboid.span(), message, "empty", Some(help)));
    }
    Ok(cells)
}

fn where_cell<T>(cells: impl Iterator<Item = T>, holds: impl Fn(&T) -> bool) -> Vec<usize> {
    let numbered = cells.enumerate().filter(|(_, cell)| holds(cell));
    numbered.map(|(index, _)| index).collect()
}

/// What the mesh has instead of a region that it does not have.
fn known_regions(mesh: &TetMesh, wanted: &RegionTag) -> String {
    let mut counts: BTreeMap<i64, usize> = BTreeMap::new();
    for region in mesh.regions() {
        *counts.entry(*region).or_default() += 1;
    }
    if counts.keys().eq([&0]) && mesh.region_names().is_empty() {
        return "the mesh file gives its cells no regions: name them by `box = { min_m = [..], max_m = [..] }`"
            .to_owned();
    }
    let shown = |(region, cells): (&i64, &usize)| match mesh.region_names().get(region) {
        Some(name) => format!("{region} or \"{name}\" ({cells} cells)"),
        None => format!("{region} ({cells} cells)"),
    };
    let all: Vec<String> = counts.iter().map(shown).collect();
    let names: Vec<&str> = mesh.region_names().values().map(String::as_str).collect();
    let meant = match wanted {
        RegionTag::Name(name) => nearest(name, &names),
        RegionTag::Number(_) => None,
    };
    let meant = meant.map_or(String::new(), |name| format!("did you mean \"{name}\"? "));
    format!("{meant}The mesh has {}", all.join(", "))
}
