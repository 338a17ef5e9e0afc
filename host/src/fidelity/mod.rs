//! How true and how stable the console's force is, by simulation: a console with a hand at the end of a link
//! to a late host, against the same scene solved every millisecond.
//!
//! Entry points: [`run::run`] for one run, [`measure`] for what it says, [`stiffest`] for the largest stable
//! stiffness.

pub mod case;
pub mod corners;
pub mod hand;
pub mod link;
pub mod measure;
pub mod notice;
pub mod oracles;
pub mod plant;
pub mod random;
pub mod run;
pub mod scenes;
pub mod stiffest;
pub mod suite;
