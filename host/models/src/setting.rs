//! Checks of a model's settings.
//!
//! Entry point: [`within`].

use crate::BuildError;

/// Refuses a setting that is no number or lies outside `least..=most`.
pub(crate) fn within(
    name: &'static str,
    value: f64,
    least: f64,
    most: f64,
    limit: &'static str,
) -> Result<(), BuildError> {
    if value.is_finite() && value >= least && value <= most {
        Ok(())
    } else {
        Err(BuildError::Setting { name, value, limit })
    }
}
