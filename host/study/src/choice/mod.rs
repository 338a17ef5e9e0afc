//! Which tissue model, with which setting, a session takes: the most accurate one that holds its budget here, among those
//! that have the scene's own contact law.
//!
//! Entry points: [`measure`] for what each costs and how far off it is, [`choose`] for the choice, which is a function of
//! that alone.

mod measure;
mod way;

pub use measure::{Asked, measure};
pub use sutura_host::session::{Candidate, Chosen, StepUs};

use sutura_host::scene::Tissue;

/// Share of the budget that a measured step may take: a session's machine has more to do than a calibration's.
pub const SAFE_SHARE: f64 = 0.8;

/// The candidate to take, and whether it holds the budget: the least error among those whose slowest hundredth takes no more
/// than [`SAFE_SHARE`] of it, the faster of two that are as good; if none does, the fastest of all. None if none was run.
pub fn choose(candidates: &[Candidate], budget_us: f64) -> Option<(usize, bool)> {
    let timed = || {
        let each = candidates.iter().enumerate();
        each.filter_map(|(index, candidate)| Some((index, candidate, candidate.step_us?)))
    };
    let good = timed().filter_map(|(index, candidate, step_us)| {
        let error = candidate.error.filter(|error| error.is_finite())?;
        (step_us.p99 <= SAFE_SHARE * budget_us).then_some((index, error, step_us.p50))
    });
    let best = good.min_by(|a, b| a.1.total_cmp(&b.1).then(a.2.total_cmp(&b.2)));
    if let Some((index, ..)) = best {
        return Some((index, true));
    }
    let fastest = timed().min_by(|a, b| a.2.p99.total_cmp(&b.2.p99));
    fastest.map(|(index, ..)| (index, false))
}

/// A model that has not been run.
fn candidate(tissue: Tissue) -> Candidate {
    let text = tissue.to_string();
    let setting = text.split_once(": ").map_or("", |(_, setting)| setting);
    Candidate {
        model: tissue.word(),
        setting: setting.to_owned(),
        step_us: None,
        error: None,
        displacement_error: None,
        note: String::new(),
        tissue: text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(model: &'static str, p50: f64, p99: f64, error: f64) -> Candidate {
        Candidate {
            model,
            setting: String::new(),
            tissue: model.to_owned(),
            step_us: Some(StepUs { p50, p99 }),
            error: Some(error),
            displacement_error: None,
            note: String::new(),
        }
    }

    fn rows() -> Vec<Candidate> {
        vec![
            row("fast", 100.0, 120.0, 0.2),
            row("exact", 9000.0, 9900.0, 0.001),
            row("good", 700.0, 790.0, 0.03),
            row("spiky", 200.0, 2000.0, 0.01),
        ]
    }

    #[test]
    fn the_least_error_within_the_budget_is_taken() {
        for (budget_us, expected) in [
            (1e6, (1, true)),
            // The slowest hundredth counts, and a fifth is kept.
            (12_000.0, (3, true)),
            (1000.0, (2, true)),
            (980.0, (0, true)),
            (150.0, (0, true)),
            (149.0, (0, false)),
            (1.0, (0, false)),
        ] {
            assert_eq!(choose(&rows(), budget_us), Some(expected), "{budget_us} us");
        }
    }

    #[test]
    fn time_decides_between_equals_and_what_was_not_measured_is_not_taken() {
        let mut rows = rows();
        rows.push(row("as good", 500.0, 790.0, 0.03));
        assert_eq!(choose(&rows, 1000.0), Some((4, true)));
        rows[4].error = None;
        assert_eq!(choose(&rows, 1000.0), Some((2, true)));
        rows[2].error = Some(f64::NAN);
        assert_eq!(choose(&rows, 1000.0), Some((0, true)));
        for row in &mut rows {
            row.error = None;
        }
        assert_eq!(choose(&rows, 1000.0), Some((0, false)));
        rows[0].step_us = None;
        assert_eq!(choose(&rows[..1], 1000.0), None);
        assert_eq!(choose(&[], 1000.0), None);
    }
}
