//! How true and how stable the console's force is, by simulation: a console with a hand at the end of a link
//! to a late host, against the same scene solved every millisecond.
//!
//! Entry points: [`run::run`] for one run, [`measure`] and [`notice`] for what it says, [`stiffest`] for the largest
//! stable stiffness, [`suite`] for the published cases, [`bars`] for what they must be, [`mutants`] for what each guard
//! is for, [`report`] for all of it, [`trials`] and [`corners`] for what such cases hide.

pub mod around;
pub mod bars;
pub mod case;
pub mod corners;
pub mod draws;
pub mod hand;
pub mod link;
pub mod measure;
pub mod mutants;
pub mod notice;
pub mod oracles;
pub mod places;
pub mod plant;
pub mod random;
pub mod report;
pub mod returns;
pub mod run;
pub mod scenes;
pub mod spec;
pub mod stiffest;
pub mod stops;
pub mod suite;
pub mod switches;
pub mod targets;
pub mod traces;
pub mod trials;
