//! Which cases the property tests draw: the same every time, or fresh ones. Entry point: [`Cases`].

use crate::mesher;
use crate::run::Tool;
use std::time::{SystemTime, UNIX_EPOCH};

/// What the property tests' generator reads; `.cargo/config.toml` has its usual value.
const SEED: &str = "PROPTEST_RNG_SEED";

/// What tests with a long form look for.
const FULL: &str = "SUTURA_FULL";

/// Cases of the property tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cases {
    /// Whether tests take their long forms.
    pub full: bool,
    /// Of the generator, where it is chosen here.
    pub seed: Option<u64>,
}

impl Cases {
    /// The usual cases; with `full` fresh ones, unless there is a seed.
    pub fn new(full: bool, seed: Option<u64>) -> Self {
        let fresh = || {
            let now = SystemTime::now().duration_since(UNIX_EPOCH);
            now.map_or(0, |since| since.as_nanos() as u64)
        };
        let seed = seed.or_else(|| full.then(fresh));
        Self { full, seed }
    }

    /// The test runner's profile, in `.config/nextest.toml`.
    pub fn profile(self) -> &'static str {
        if self.full { "full" } else { "default" }
    }

    /// Says what is drawn, and how to draw it again.
    pub fn describe(self) -> String {
        // Cargo's, for all that it runs, unless the user has set another one.
        self.describe_beside(std::env::var(SEED).ok())
    }

    fn describe_beside(self, environment: Option<String>) -> String {
        match (self.full, self.seed) {
            (false, None) => match environment {
                Some(seed) => format!("property tests draw the cases of {SEED}={seed}"),
                None => "property tests draw the same cases every time".to_owned(),
            },
            (false, Some(seed)) => format!("property tests draw the cases of seed {seed}"),
            (true, seed) => {
                let seed = seed.unwrap_or_default();
                format!(
                    "property tests draw the cases of seed {seed}, tests take their long forms; the same again:\n    \
                     cargo xtask test --full --seed {seed}"
                )
            }
        }
    }

    /// A program that runs tests.
    pub fn of(self, tool: Tool) -> Tool {
        let tool = match self.seed {
            Some(seed) => tool.env(SEED, seed.to_string()),
            None => tool,
        };
        if !self.full {
            return tool;
        }
        // Where cargo does not say where it builds nothing is there to be found.
        let tool = match mesher::on_path() {
            Ok(path) => tool.env("PATH", path),
            Err(_) => tool,
        };
        tool.env(FULL, "1")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_full_run_draws_fresh_cases_and_says_how_to_draw_them_again() {
        assert_eq!(Cases::new(false, None).seed, None);
        let full = Cases::new(true, None);
        let seed = full.seed.expect("a seed");
        assert!(full.describe().contains(&format!("--seed {seed}")));
        let tool = full.of(Tool::new("cargo test"));
        let shown = tool.shown();
        assert!(
            shown.contains("SUTURA_FULL='1'") && shown.contains(&format!("{SEED}='{seed}'")),
            "{shown}"
        );
        let usual = Cases::new(false, None).of(Tool::new("cargo test")).shown();
        assert_eq!(usual, "cargo test");
    }

    #[test]
    fn the_words_name_the_seed_that_is_drawn() {
        let words = |full, seed, set: Option<&str>| {
            Cases::new(full, seed).describe_beside(set.map(str::to_owned))
        };
        assert!(words(false, None, Some("5")).ends_with("PROPTEST_RNG_SEED=5"));
        assert!(words(false, None, None).ends_with("every time"));
        // What is given here is given to the tests, too, over what is set.
        assert!(words(false, Some(7), Some("5")).ends_with("seed 7"));
        assert!(words(true, Some(7), Some("5")).ends_with("--full --seed 7"));
    }

    /// A plain `cargo test` draws the same cases, too.
    #[test]
    fn the_usual_seed_is_set_for_every_cargo_command() {
        let path = crate::run::root().join(".cargo/config.toml");
        let text = std::fs::read_to_string(path).expect("readable");
        let config: toml::Table = toml::from_str(&text).expect("TOML");
        assert!(config["env"][SEED].is_str(), "{text}");
    }
}
