//! Rigid, frictionless spheres against the boundary vertices of linear tissue: one unilateral row per
//! touched vertex, solved together with its turning normal, and its exact tangent.
//!
//! Vertex i of a sphere with centre c and radius R has the gap `g_i = |x_i - c| - R >= 0` and the
//! normal `n_i = (x_i - c) / |x_i - c|`, which points from the tool into the tissue. Its multiplier
//! `lambda_i >= 0` pushes the tissue with `p_i = lambda_i n_i` and the tool with `-p_i`;
//! `lambda_i g_i = 0`. Tissue answers `u = S p`, S the columns of K^-1 at touched vertices.

pub(crate) mod active_set;
pub(crate) mod columns;
pub(crate) mod tangent;
