//! Rigid, frictionless tools against the boundary vertices of linear tissue: one unilateral row for every
//! vertex and tool that touch, solved together with its turning normal, and the exact tangent.
//!
//! Vertex i has the gap `g_i >= 0`, its signed distance from the tool's convex shape, and the normal `n_i`,
//! the distance's gradient, which points from the tool into the tissue. Its multiplier `lambda_i >= 0`
//! pushes the tissue with `p_i = lambda_i n_i` and the tool with `-p_i`; `lambda_i g_i = 0`. Tissue answers
//! `u = S p`, S the columns of K^-1 at touched vertices.

pub(crate) mod active_set;
pub(crate) mod entry;
pub(crate) mod newton;
pub(crate) mod reduction;
pub(crate) mod shape;
pub(crate) mod tangent;
