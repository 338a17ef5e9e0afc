//! Surfaces of triangles, as files have them: read, repaired where there is one way to do it, and checked.
//!
//! Entry points: [`SurfaceFormat::read`], [`TriangleMesh::repair`], [`TriangleMesh::check`]. A boundary of tetrahedra is a
//! [`super::Surface`], and needs none of this.

mod check;
mod close;
mod flaw;
mod obj;
mod ply;
mod polygon;
mod repair;
mod stl;
#[cfg(test)]
mod tests;

pub use check::Closed;
pub use flaw::SurfaceFlaw;
pub use repair::Repaired;

use super::MeshError;
use super::read::Scan;
use nalgebra::Vector3;
use std::path::Path;

/// Corners of a face at most: what it takes to split one grows with their cube.
const MOST_CORNERS: usize = 1000;

/// Formats of files that hold surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceFormat {
    /// Stereolithography, ASCII or binary.
    Stl,
    /// Wavefront's text.
    Obj,
    /// Stanford's polygons, ASCII or binary of either order of bytes.
    Ply,
}

impl SurfaceFormat {
    /// By a file's extension, in any case.
    ///
    /// # Errors
    /// [`MeshError::NoSurface`].
    pub fn of(path: &Path) -> Result<Self, MeshError> {
        let extension = path.extension().and_then(|extension| extension.to_str());
        match extension.map(str::to_ascii_lowercase).as_deref() {
            Some("stl") => Ok(Self::Stl),
            Some("obj") => Ok(Self::Obj),
            Some("ply") => Ok(Self::Ply),
            _ => Err(MeshError::NoSurface(path.display().to_string())),
        }
    }

    /// The surface in a file's `bytes`, whose unit is `scale_to_m` metres; faces of more than three corners are split.
    ///
    /// # Errors
    /// A [`MeshError`] with the line or byte of what cannot be read.
    pub fn read(self, bytes: &[u8], scale_to_m: f64) -> Result<TriangleMesh, MeshError> {
        if !(scale_to_m.is_finite() && scale_to_m > 0.0) {
            return Err(MeshError::Scale(scale_to_m));
        }
        let mut surface = match self {
            Self::Stl => stl::read_stl(bytes)?,
            Self::Obj => obj::read_obj(bytes)?,
            Self::Ply => ply::read_ply(bytes)?,
        };
        for x in surface.points_m.iter_mut().flatten() {
            *x *= scale_to_m;
        }
        Ok(surface)
    }
}

/// Triangles between points, of which nothing has been checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Positions \[m\], (n x 3).
    pub points_m: Vec<[f64; 3]>,
    /// Points at the corners of each triangle, counter-clockwise seen from outside, (f x 3).
    pub triangles: Vec<[u32; 3]>,
    /// The file's number of the face that each triangle is of, from 0, (f); none where triangles count for themselves.
    faces: Vec<u32>,
}

impl TriangleMesh {
    /// Of points \[m\], (n x 3), and triangles by their corners, (f x 3).
    pub fn new(points_m: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> Self {
        Self {
            points_m,
            triangles,
            faces: Vec::new(),
        }
    }

    /// The number in the file, from 0, of the face that a triangle is of.
    pub fn face(&self, triangle: usize) -> usize {
        let face = self.faces.get(triangle);
        face.map_or(triangle, |face| *face as usize)
    }

    /// Volume inside by the triangles' orientation \[m^3\].
    pub fn volume_m3(&self) -> f64 {
        let six_fold = (0..self.triangles.len()).map(|triangle| {
            let [a, b, c] = self.corners(triangle);
            a.dot(&b.cross(&c))
        });
        six_fold.sum::<f64>() / 6.0
    }

    /// Corners of one triangle \[m\]; not a number where a point does not exist.
    pub fn corners(&self, triangle: usize) -> [Vector3<f64>; 3] {
        self.triangles[triangle].map(|point| {
            let at = self.points_m.get(point as usize);
            Vector3::from(at.copied().unwrap_or([f64::NAN; 3]))
        })
    }

    /// Takes a face by its corners, as triangles.
    fn push_face(&mut self, file: &Scan, face: u32, corners: &[u32]) -> Result<(), MeshError> {
        if !(3..=MOST_CORNERS).contains(&corners.len()) {
            let what = format!("a face of 3 to {MOST_CORNERS} corners");
            let found = match corners.len() > MOST_CORNERS {
                true => "more".to_owned(),
                false => corners.len().to_string(),
            };
            return Err(file.expected(&what, &found));
        }
        for triangle in polygon::split(&self.points_m, corners) {
            self.triangles.push(triangle);
            self.faces.push(face);
        }
        Ok(())
    }
}
