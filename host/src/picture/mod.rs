//! Pictures of a running scene, as bytes that a page shows: where the tissue is, its stress, tools, needles, threads.
//!
//! Entry points: [`Showing`] offers a solver's state to whoever draws it, [`Painter::paint`] makes a [`Picture`] of it, which
//! [`Picture::encode`] writes as the book's page "The page's format" says. Nothing here waits for whom it is for.

mod boundary;
mod bytes;
mod describe;
mod message;
mod offer;
mod painter;
mod read;
mod telemetry;

pub use boundary::Boundary;
pub use describe::{describe_needles, describe_threads, describe_tools, statuses};
pub use message::{NeedleView, Picture, StatusView, ThreadPointView, ThreadView, ToolView};
pub use offer::{Heard, Offer, Offering, Showing};
pub use painter::{Painter, Scalar};
pub use read::Read;
pub use telemetry::{SolveRow, SolvesOf, TickRow, encode_solves, encode_ticks};

/// Version of the page's format.
pub const FORMAT: u8 = 1;
