//! The host of a Sutura console: soft-tissue solver, scenes, and the host's end of the link.
//!
//! The solver: [`mesh`] and [`fem`] make a [`model::Model`] of tissue and tools, [`step::step`] follows
//! the tools and gives each its wrench and exact contact Jacobian.

pub mod anchors;
mod body;
pub mod boxes;
mod clock;
pub mod collide;
mod columns;
mod contact;
pub mod core_time;
pub mod event;
pub mod fem;
mod hash;
pub mod jaws;
mod marks;
pub mod model;
pub mod needle;
pub mod output;
pub mod picture;
pub mod prescribed;
pub mod recording;
pub mod registry;
mod renewal;
pub mod rod;
pub mod rows;
pub mod scene;
pub mod script;
pub mod session;
pub mod solve;
mod source;
pub mod step;
pub mod text;
pub mod thread;
pub mod tool;
pub mod work;
pub mod wound;

pub use sutura_client::times;
/// The host's end of the link, which other simulators have too.
pub use sutura_client::{link, scheduling};
/// Tetrahedral meshes.
pub use sutura_mesh as mesh;
/// Tissue models that need no contact solver, and their laws.
pub use sutura_models as models;
