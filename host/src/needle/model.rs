//! What is constant about needles.
//!
//! Entry points: [`NeedlePart`], [`NeedleSettings`].

use super::{Needle, NeedleTissue};
use crate::rod::PIECE_RADII;
use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

/// Most needles in one model.
pub const MAX_NEEDLES: usize = 4;

/// A needle of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedlePart {
    /// Names it.
    pub id: u8,
    /// Its shape.
    pub needle: Needle,
    /// Where its frame is before the first step: outside the tissue.
    pub start: Isometry3<f64>,
    /// Whether its shaft touches the surface where it is outside of the tissue.
    pub body: bool,
    /// What it falls with where nobody holds it; without, it stays where it is.
    pub weight: Option<NeedleWeight>,
}

/// What a needle weighs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedleWeight {
    /// Of what it is made of \[kg/m^3\].
    pub density_kg_per_m3: f64,
    /// What it falls with \[m/s^2\], (3), world frame.
    pub gravity_m_per_s2: [f64; 3],
}

impl NeedlePart {
    /// What is wrong with its shape or its start.
    pub(crate) fn flaw(&self) -> Option<String> {
        let coords = self.start.to_homogeneous();
        let is_finite = coords.iter().all(|x| x.is_finite());
        let lost = || (!is_finite).then(|| "its start is not finite".to_owned());
        let weightless = || {
            let weight = self.weight?;
            let is_finite = weight.gravity_m_per_s2.iter().all(|g| g.is_finite());
            let density = weight.density_kg_per_m3;
            let is_sound = is_finite && density.is_finite() && density > 0.0;
            (!is_sound)
                .then(|| format!("its density is {density} kg/m^3, or its gravity not finite"))
        };
        self.needle.flaw().or_else(lost).or_else(weightless)
    }

    /// Longest piece of a path on which nothing that its body meets comes to be on the body's other side \[m\].
    pub(crate) fn body_piece_m(&self) -> f64 {
        PIECE_RADII * 0.5 * self.needle.thickness_m
    }
}

/// How a needle's way since the first contact is followed once its tip has broken through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Playback {
    /// The tip's path through the tissue as it is without the tip's force, and one solve at its end.
    #[default]
    OneSolve,
    /// A solve at each of up to 16 poses.
    EveryPose,
}

/// What needles may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedleSettings {
    /// What follows a puncture.
    pub playback: Playback,
    /// Most faces that one needle can go through.
    pub most_crossings: usize,
    /// Vertices whose columns one step may compute before it waits.
    pub vertices_per_step: usize,
    /// Memory for columns \[bytes\].
    pub memory_bytes: usize,
}

impl Default for NeedleSettings {
    /// 48 crossings are ten tube walls; 64 vertices are all that a few new ones, or a refactorisation, ask for.
    fn default() -> Self {
        Self {
            playback: Playback::OneSolve,
            most_crossings: 48,
            vertices_per_step: 64,
            memory_bytes: 512 << 20,
        }
    }
}

/// Why needles cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NeedleError {
    /// A needle without a sound shape or pose.
    #[error("needle {id}: {flaw}")]
    Flaw {
        /// Which needle.
        id: u8,
        /// What is wrong with it.
        flaw: String,
    },
    /// A needle that is in tissue before the first step.
    #[error("needle {id} starts in the tissue; start it outside, it gets in by its tip")]
    Inside {
        /// Which needle.
        id: u8,
    },
    /// One id for two needles.
    #[error("two needles have the id {0}")]
    SameNeedle(u8),
    /// More needles than a step has room for.
    #[error("{0} needles; at most {MAX_NEEDLES} are possible")]
    TooMany(usize),
    /// Properties for another number of cells.
    #[error("needle properties for {given} cells; the mesh has {cells}")]
    Cells {
        /// How many there are.
        given: usize,
        /// How many there should be.
        cells: usize,
    },
    /// A property that is below zero or not a number.
    #[error("{what} is {value}; it must be zero or above{}", if ["puncture_pa", "surface_friction"].contains(what) { "" } else { " and finite" })]
    Property {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A setting out of range.
    #[error("`{what}` is {value}; it must be at least {least}")]
    Setting {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: usize,
        /// The least possible.
        least: usize,
    },
}

/// Whether a point lies in a cell, which has its corners in the mesh's order.
pub(crate) fn contains(corners: &[Vector3<f64>; 4], at: &Vector3<f64>) -> bool {
    let volume = |[a, b, c, d]: [Vector3<f64>; 4]| (b - a).cross(&(c - a)).dot(&(d - a));
    let whole = volume(*corners);
    (0..4).all(|corner| {
        let mut part = *corners;
        part[corner] = *at;
        volume(part) * whole > 0.0
    })
}

/// Refuses properties that are below zero or not numbers.
pub(crate) fn check(tissue: &NeedleTissue) -> Result<(), NeedleError> {
    let NeedleTissue {
        friction_n_per_m,
        static_friction_n_per_m,
        viscous_n_s_per_m2,
        cutting_pa,
        puncture_pa,
        surface_friction,
    } = *tissue;
    for (what, value) in [
        ("friction_n_per_m", friction_n_per_m),
        ("static_friction_n_per_m", static_friction_n_per_m),
        ("viscous_n_s_per_m2", viscous_n_s_per_m2),
        ("cutting_pa", cutting_pa),
        ("puncture_pa", puncture_pa),
        ("surface_friction", surface_friction),
    ] {
        let may_be_endless = ["puncture_pa", "surface_friction"].contains(&what);
        let endless = value.is_infinite() && !may_be_endless;
        if value.is_nan() || value < 0.0 || endless {
            return Err(NeedleError::Property { what, value });
        }
    }
    Ok(())
}
