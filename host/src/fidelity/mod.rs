//! How true and how stable the console's force is, by simulation: a console with a hand at the end of a link
//! to a late host, against the same scene solved every millisecond.
//!
//! Entry points: [`run::run`] for one run, [`measure`] and [`notice`] for what it says, [`stiffest`] for the largest
//! stable stiffness, [`suite`] for the published cases, [`trials`] and [`corners`] for what such cases hide.

pub mod around;
pub mod case;
pub mod corners;
pub mod draws;
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
pub mod targets;
pub mod trials;
