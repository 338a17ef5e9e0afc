//! Isotropic elasticity: two numbers, checked, for the whole mesh or by cell.
//!
//! Entry points: [`Material`], [`Materials`].

use thiserror::Error;

/// An isotropic material at small strain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Young's modulus \[Pa\], above zero.
    pub youngs_modulus_pa: f64,
    /// Poisson's ratio, above -1 and below 0.5.
    pub poisson_ratio: f64,
}

/// Why a material is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum MaterialError {
    /// No stiffness, or not a number.
    #[error("Young's modulus is {0} Pa; it must be finite and above zero")]
    YoungsModulus(f64),
    /// Outside the range in which the energy is positive.
    #[error(
        "Poisson's ratio is {0}; it must be above -1 and below 0.5 (0.45 to 0.49 for soft tissue)"
    )]
    PoissonRatio(f64),
    /// Not one material per cell.
    #[error("{given} cells are given a material, but the mesh has {cells}")]
    CellCount {
        /// Cells that are given one.
        given: usize,
        /// Cells of the mesh.
        cells: usize,
    },
    /// A number beyond the list of materials.
    #[error("cell {cell} is given material {material}, but there are {materials}, counted from 0")]
    NoSuchMaterial {
        /// 0-based index of the cell.
        cell: usize,
        /// The number.
        material: u32,
        /// Materials in the list.
        materials: usize,
    },
}

impl Material {
    /// Checks the two numbers.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(self) -> Result<(), MaterialError> {
        if !(self.youngs_modulus_pa.is_finite() && self.youngs_modulus_pa > 0.0) {
            return Err(MaterialError::YoungsModulus(self.youngs_modulus_pa));
        }
        if !(self.poisson_ratio > -1.0 && self.poisson_ratio < 0.5) {
            return Err(MaterialError::PoissonRatio(self.poisson_ratio));
        }
        Ok(())
    }

    /// Lame's parameters (lambda, mu) \[Pa\].
    pub fn lame(self) -> (f64, f64) {
        let (e, nu) = (self.youngs_modulus_pa, self.poisson_ratio);
        (
            e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)),
            e / (2.0 * (1.0 + nu)),
        )
    }
}

/// What each cell of a mesh is made of.
///
/// ```
/// use sutura_models::{Material, Materials};
/// let fat = Material { youngs_modulus_pa: 3e3, poisson_ratio: 0.45 };
/// let skin = Material { youngs_modulus_pa: 60e3, poisson_ratio: 0.45 };
/// let everywhere = Materials::from(fat);
/// let layered = Materials::by_cell(vec![fat, skin], vec![0, 0, 0, 1]);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Materials {
    list: Vec<Material>,
    /// Index into `list` of each cell; `None`: the first for all.
    of_cell: Option<Vec<u32>>,
}

impl From<Material> for Materials {
    fn from(material: Material) -> Self {
        Self {
            list: vec![material],
            of_cell: None,
        }
    }
}

impl Materials {
    /// A list of materials and each cell's index into it, (m). Whatever builds tissue checks it against
    /// the mesh.
    pub fn by_cell(list: Vec<Material>, of_cell: Vec<u32>) -> Self {
        Self {
            list,
            of_cell: Some(of_cell),
        }
    }

    /// Checks every material, and that each of `cells` cells has one.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self, cells: usize) -> Result<(), MaterialError> {
        for material in &self.list {
            material.check()?;
        }
        let Some(of_cell) = &self.of_cell else {
            return Ok(());
        };
        if of_cell.len() != cells {
            return Err(MaterialError::CellCount {
                given: of_cell.len(),
                cells,
            });
        }
        let materials = self.list.len();
        let beyond = |index: &u32| *index as usize >= materials;
        match of_cell.iter().position(beyond) {
            Some(cell) => Err(MaterialError::NoSuchMaterial {
                cell,
                material: of_cell[cell],
                materials,
            }),
            None => Ok(()),
        }
    }

    /// Material of one cell, after [`Self::check`].
    pub fn of(&self, cell: usize) -> Material {
        let index = self.of_cell.as_ref().map_or(0, |of_cell| of_cell[cell]);
        self.list[index as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_checked() {
        let material = |youngs_modulus_pa, poisson_ratio| Material {
            youngs_modulus_pa,
            poisson_ratio,
        };
        assert!(material(1.0, 0.49).check().is_ok());
        assert!(material(1.0, -0.5).check().is_ok());
        for (e, nu) in [
            (0.0, 0.3),
            (-1.0, 0.3),
            (f64::NAN, 0.3),
            (f64::INFINITY, 0.3),
            (1.0, 0.5),
            (1.0, -1.0),
            (1.0, f64::NAN),
        ] {
            assert!(material(e, nu).check().is_err(), "{e} {nu}");
        }
    }

    #[test]
    fn every_cell_needs_a_material_that_exists() {
        let soft = Material {
            youngs_modulus_pa: 1.0,
            poisson_ratio: 0.3,
        };
        assert!(Materials::from(soft).check(7).is_ok());
        let of = |of_cell: &[u32]| Materials::by_cell(vec![soft, soft], of_cell.to_vec()).check(3);
        assert!(of(&[0, 1, 0]).is_ok());
        assert_eq!(
            of(&[0, 1]),
            Err(MaterialError::CellCount { given: 2, cells: 3 })
        );
        assert_eq!(
            of(&[]),
            Err(MaterialError::CellCount { given: 0, cells: 3 })
        );
        assert_eq!(
            of(&[0, 2, 3]),
            Err(MaterialError::NoSuchMaterial {
                cell: 1,
                material: 2,
                materials: 2
            })
        );
        let stiff = Material {
            poisson_ratio: 0.5,
            ..soft
        };
        assert!(
            Materials::by_cell(vec![soft, stiff], vec![0; 3])
                .check(3)
                .is_err()
        );
    }
}
